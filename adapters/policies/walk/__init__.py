"""The station's own policies that follow velocities, for a Go2 and a G1."""
