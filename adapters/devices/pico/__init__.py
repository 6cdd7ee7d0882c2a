"""A Pico headset with its controllers, body trackers and hands, through XRoboToolkit's PC service and library.

The library is awkward, and this package is where that ends: `headset` has the traps, each with what was done about it.
"""
