"""Small wrong patches of the product, each of which the suite must notice: ``python -m tests.mutants``."""
