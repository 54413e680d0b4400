"""The process and its surroundings: streams, signals, output files, private directories."""
