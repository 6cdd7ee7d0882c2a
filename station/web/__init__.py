"""A running station in a browser: who may look and ask, what is shown, and how it gets there.

Every page is one more client of the bus, never a part of what moves a robot: whatever dies here, a robot does not
notice. The stop is the exception that proves it: a page presses the same button as a terminal does.
"""
