"""Structure from motion with COLMAP: features, matching, mapping, what went wrong with which photo.

``features`` and ``matching`` fill a COLMAP database, ``mapping`` turns it into a model over several
attempts that ``agreement`` judges, ``refine`` is its last round, ``uncertainty`` tells how sure the
cameras are, ``diagnosis`` explains each photo and ``export`` writes what later stages read.
"""
