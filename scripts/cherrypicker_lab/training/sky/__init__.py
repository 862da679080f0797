"""Training of the sky network, and what its parts are worth."""
