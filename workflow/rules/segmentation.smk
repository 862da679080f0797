# The network that labels the cloud.


rule segment_cloud:
    input:
        cloud="results/{tree}/metric.ply",
        scale=photo_only("results/{tree}/scale.json"),
        align=photo_only("results/{tree}/align.json"),
        weights_file=weights_of("segment.weights", "weights/dgcnn.pt"),
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
