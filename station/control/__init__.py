"""From command to robot: what is refused, the gate, arming, the control step, the loop of a low-level server."""
