"""What is said of the instrument's own light, its signature: what it has been subtracted from."""


def subtracted(*, reflected: bool, scale: bool, known: float) -> list[str]:
    """A note, where it has been subtracted from anything: from reflected light, or from the etalon's that transmitted light is
    scaled by. Transmitted light itself is never freed of it: without a sample there is the beam. `known` is its relative
    uncertainty where a sample is.
    """
    light = [
        *(["reflected light"] if reflected else []),
        *(["the etalon's light that transmitted light is scaled by"] if scale else []),
    ]
    told = "the instrument's own light was measured without a sample and has been subtracted from"
    same = f"with a sample it is taken to be the same to {100.0 * known:.2g} %"
    return [f"{told} {' and from '.join(light)}; {same}"] if light else []
