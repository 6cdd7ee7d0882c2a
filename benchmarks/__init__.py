"""How fast the station is, beside the stock pattern in the same run: ``python -m benchmarks``."""
