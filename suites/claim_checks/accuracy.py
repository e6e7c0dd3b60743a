"""Errors of what users get against the float64 reference."""

from pathlib import Path

from splatproof.suites.claim_checks.check import Check, Measurement
from splatproof.suites.studies.speed.judge import judge
from splatproof.suites.twins.registry import COMPONENTS
from splatproof.suites.twins.twin import Size


def errors(component: str, key: str, sizes: tuple[Size, ...]) -> Measurement:
    """The largest error of the twins that approximate nothing, a value a twin and size.

    Args:
        component: Name of the component, see splatproof.suites.twins.registry.
        key: "max_abs_error" of outputs or "grad_rel_l2" of gradients.
        sizes: Problems that are judged; every size has numbers of its own.
    """
    chosen = COMPONENTS[component]
    exact = [twin.name for twin in chosen.twins if not twin.approximates]
    found = [judge(chosen, chosen.problem(size)) for size in sizes]
    labels = ", ".join(map(chosen.label, sizes))
    return Measurement(
        values=tuple(float(one[name][key]) for one in found for name in exact),
        compared=f"{', '.join(exact)} against float64, {labels}",
    )


def _judged(component: str, key: str) -> Check:
    chosen = COMPONENTS[component]
    few, all_ = (chosen.tiny,), (chosen.tiny, chosen.judged)

    def measure(reduced: bool, folder: Path) -> Measurement:
        del folder
        return errors(component, key, few if reduced else all_)

    unit = "" if key == "grad_rel_l2" else "of 1"
    return Check(measure=measure, unit=unit, seconds=(6.0, 1.0))


ACCURACY = {
    "colour_error": _judged("rasterizer", "max_abs_error"),
    "gradient_error": _judged("rasterizer", "grad_rel_l2"),
    "decoding_error": _judged("anchors", "max_abs_error"),
    "decoding_gradient_error": _judged("anchors", "grad_rel_l2"),
}
