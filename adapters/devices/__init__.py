"""Devices of an operator: each folder translates one library into `station.operator.sample`. No loop, no bus."""
