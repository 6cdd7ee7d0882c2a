"""An episode again: to a bus, into a simulation, through the policy that it was recorded with."""
