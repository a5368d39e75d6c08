"""Studies of the twin: their sizes stand once, in config/studies, for rules and for documents."""

STUDIES = {}
for path in sorted((ROOT / "config" / "studies").glob("*.yaml")):
    with open(path) as stream:
        STUDIES[path.stem] = yaml.safe_load(stream)


def study(name):
    """Parameters of a study's rule, by name."""
    return STUDIES[name]["parameters"]


def seeds_of(name, pattern, of=""):
    """Files of the surveys of a study, a job each; pattern below results/reproduction with {seed}."""
    size = STUDIES[name]["parameters"]
    first = size[f"first_seed{of}"]
    return expand(
        f"results/reproduction/{pattern}", seed=range(first, first + size[f"seeds{of}"])
    )


def prior_surveys(wildcards):
    """Input function: surveys with wrong presumptions, by kind and seed."""
    size = STUDIES["prior_study"]["parameters"]
    return [
        f"results/reproduction/prior_study/{kind}_{size['first_seed'] + k}.csv"
        for kind, n in size["sizes"].items()
        for k in range(n)
    ]
