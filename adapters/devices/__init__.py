"""Devices of an operator: each folder translates one library into `station.operator.reading`. No loop, no bus."""
