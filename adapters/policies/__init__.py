"""One file or folder per policy family."""
