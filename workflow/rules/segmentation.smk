# The network that labels the cloud.


rule segment_cloud:
    input:
        cloud="results/{tree}/metric.ply",
        # Absent weights are the stage's to report, by the name of the key.
        weights_file=lambda wildcards: [
            path
            for path in [
                cfg("segment.weights")(wildcards) or resource("weights/dgcnn.pt")
            ]
            if Path(path).is_file()
        ],
        code=code("segment_cloud"),
    output:
        segmented=ensure("results/{tree}/segmented.ply", non_empty=True),
    log:
        "logs/segment_cloud/{tree}.log",
    benchmark:
        "benchmarks/segment_cloud/{tree}.tsv"
    conda:
        "../../envs/learning.yaml"
    threads: threads_for("segment_cloud")
    resources:
        mem_mb=mb_for("segment_cloud"),
        runtime=minutes_for("segment_cloud"),
        gpu=0,
    params:
        **options("segment_cloud"),
    message:
        "{wildcards.tree}: label the cloud"
    script:
        "../../scripts/segment_cloud.py"
