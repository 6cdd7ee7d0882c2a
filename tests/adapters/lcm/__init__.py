"""LCM: types, packets, the socket, and LCM's own library as a peer."""
