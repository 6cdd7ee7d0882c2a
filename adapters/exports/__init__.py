"""One format per module; `station.export` holds what they share."""
