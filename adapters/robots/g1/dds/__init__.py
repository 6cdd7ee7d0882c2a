"""A Unitree G1 on its own network: DDS messages of its motors, state, remote, hands and services."""
