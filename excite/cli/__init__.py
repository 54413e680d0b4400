"""The command line: a grammar, what the commands print, and one module a command."""
