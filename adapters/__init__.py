"""Pure translation between the outside and us: no loop, no bus, no thread."""
