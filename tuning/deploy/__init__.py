"""Ships a bundle and the station program to a machine: as one file, or over ssh."""
