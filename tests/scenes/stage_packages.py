"""What every fork for Snakemake or a stage has, loaded and used once.

Only the process that is forked imports this. The first compiled function and the first figure load
more than their packages do, in every fork anew. The garbage collector is told to leave all of it
alone: else each fork's first collection looks through it, and copies its pages.
"""

import gc
from importlib import import_module

import numba
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from snakemake.cli import get_argument_parser

for name in (
    *("snakemake.api", "snakemake.benchmark", "snakemake.report", "smart_open", "psutil"),
    *("scipy.spatial", "scipy.sparse.csgraph", "scipy.optimize", "scipy.stats"),
    *("cv2", "pycolmap", "networkx", "sklearn.cluster", "torch_geometric.nn", "jsonschema"),
):
    import_module(name)

get_argument_parser()  # it looks for Snakemake's plugins
numba.njit(lambda value: value)(0.0)
figure = Figure(layout="constrained")
figure.subplots().set_title("a")
FigureCanvasAgg(figure).draw()
del figure
gc.collect()
gc.freeze()
