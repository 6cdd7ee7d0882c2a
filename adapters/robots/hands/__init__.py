"""Hands on a robot's DDS network, each a robot of its own: Unitree's Dex3-1, Inspire's RH56DFX and RH56DFTP."""
