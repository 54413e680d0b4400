"""The command line: its grammar, its output, and one module for each command."""
