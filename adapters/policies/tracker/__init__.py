"""The station's own whole-body policy: follows TWIST2's command with a small network."""
