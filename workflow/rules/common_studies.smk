"""Studies of the twin: their sizes stand once, in config/studies, for rules and for documents."""

STUDIES = {}
for path in sorted((ROOT / "config" / "studies").glob("*.yaml")):
    with open(path) as stream:
        STUDIES[path.stem] = yaml.safe_load(stream)


def study(name):
    """Parameters of a study's rule, by name."""
    return STUDIES[name]["parameters"]
