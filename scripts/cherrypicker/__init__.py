"""Photos of a fruit tree in; a metric labelled cloud, skeleton, topology graph and traits out."""

__version__ = "0.1.0"
