"""The commands of `hapticlod`, one module each; tuning/cli.py imports them when they are called."""
