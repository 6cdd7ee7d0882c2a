"""Recordings of other recorders, taken in as episodes; what reads them is an adapter."""
