"""The robot twin of a G1: what stands at the other end of the cable, in a process of its own, with its faults."""
