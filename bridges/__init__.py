"""Other buses and native code."""
