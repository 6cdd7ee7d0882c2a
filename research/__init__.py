"""How the built-in policies were trained: DAgger on simulated robots, on the processor alone. No part of the wheel."""
