"""Read MATLAB files: variables by name, whatever the version of the file."""
