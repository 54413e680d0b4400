"""Interface to the operating system: streams, signals, output files, private directories."""
