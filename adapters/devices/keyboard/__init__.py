"""The keys of a terminal, for discrete commands and short jogs."""
