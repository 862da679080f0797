"""Laplacian-based contraction of the wood, plain and semantic (paper, section Contraction)."""
