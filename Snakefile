from snakemake.utils import min_version

# The rules import snakemake.pathvars (9.12); the profiles bear the name profile.yaml (9.19).
min_version("9.19")


configfile: "config/config.yaml"


include: "workflow/rules/common.smk"
include: "workflow/rules/import.smk"
include: "workflow/rules/sparse.smk"
include: "workflow/rules/dense.smk"
include: "workflow/rules/placement.smk"
include: "workflow/rules/sky.smk"
include: "workflow/rules/denoise.smk"
include: "workflow/rules/scale.smk"
include: "workflow/rules/segmentation.smk"
include: "workflow/rules/skeleton.smk"
include: "workflow/rules/photo_check.smk"
include: "workflow/rules/traits.smk"
include: "workflow/rules/report.smk"
include: "workflow/rules/series.smk"
include: "workflow/rules/lab/training.smk"
include: "workflow/rules/lab/orchard.smk"
include: "workflow/rules/lab/benchmark_common.smk"
include: "workflow/rules/lab/benchmark.smk"
include: "workflow/rules/lab/skeleton_benchmark_common.smk"
include: "workflow/rules/lab/skeleton_benchmark.smk"
include: "workflow/rules/lab/traits_benchmark.smk"
include: "workflow/rules/lab/series_benchmark.smk"
include: "workflow/rules/lab/intervals_common.smk"
include: "workflow/rules/lab/intervals.smk"
include: "workflow/rules/lab/error_budget_common.smk"
include: "workflow/rules/lab/error_budget.smk"
include: "workflow/rules/lab/real_photos.smk"


rule all:
    default_target: True
    input:
        expand("results/{tree}/report.html", tree=TREES),
        expand("results/series/{series}/report.html", series=SERIES),
        "results/traits.csv",
        "results/summary.html",


onstart:
    prepare_run()


onsuccess:
    write_summary()


onerror:
    compare_finished()
    write_summary()
