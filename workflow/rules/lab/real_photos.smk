# Real scans without a truth, from photos to report: `snakemake real_photos`, with a table of trees that names them
# (config/examples/real_photos.tsv). A scan that fails keeps the table from being made here; the script makes it all
# the same.


rule real_photos:
    input:
        reports=expand("results/{tree}/report.html", tree=BATCH.listed()),
        traits="results/traits.csv",
    output:
        table=ensure("results/real_photos/table.md", non_empty=True),
        scores=ensure("results/real_photos/scores.json", non_empty=True),
    log:
        "logs/report_real_photos.log",
    conda:
        "../../../envs/report.yaml"
    threads: 1
    resources:
        mem_mb=more_at_each_attempt(2000),
        runtime=10,
    params:
        code=code("lab/report_real_photos"),
        benchmarks="benchmarks",
    message:
        "table of what the runs of real scans say"
    script:
        "../../../scripts/lab/report_real_photos.py"
