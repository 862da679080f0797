"""The laboratory: makes scenes with known truth, trains the networks and judges the product.

The product, `cherrypicker`, never imports it.
"""
