"""Bearing wood against trees of known years: trees, rates, scores."""
