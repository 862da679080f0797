# The workflow stands in workflow/Snakefile, where Snakemake's catalog and `module:` look for it.
include: "workflow/Snakefile"


# An included file does not name the target that is made by default
workflow.default_target = "all"
