"""What uses the model: optimisation, verification, comparison, deployment, the command line."""
