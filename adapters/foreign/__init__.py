"""What other recorders write, read one file format per module; `station.foreign` makes episodes of it."""
