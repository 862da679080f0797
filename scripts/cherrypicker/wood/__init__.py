"""Where wood runs: what hangs together, and which of it is the target tree."""
