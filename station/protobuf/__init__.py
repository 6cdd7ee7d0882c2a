"""Protobuf without files of types: message types made at run time, Foxglove's among them, and the bytes on the wire."""
