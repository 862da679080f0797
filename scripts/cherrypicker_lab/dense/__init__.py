"""How good dense stereo is: scores against rendered scenes, a naive floor, the benchmark's report.

Nothing here is part of the pipeline; the rules of ``workflow/rules/lab/benchmark.smk`` use it.
"""
