# SPDX-License-Identifier: Apache-2.0
"""An explanation as markdown."""

from collections.abc import Iterator

from multilica.diagnosis import Explanation, Missing

__all__ = ["explanation_markdown"]


def explanation_markdown(explanation: Explanation) -> str:
    """Format an explanation with its headline as the title."""
    return "\n\n".join(_parts(explanation))


def _parts(explanation: Explanation) -> Iterator[str]:
    yield f"# {explanation.headline}"
    if explanation.warnings:
        yield "\n".join(f"- **Warning**: {warning}" for warning in explanation.warnings)
    if explanation.known:
        yield "\n".join(f"- {known}" for known in explanation.known)
    for missing in explanation.missing:
        yield _missing(missing)
    if explanation.advice:
        yield "\n".join(f"- What helps: {advice}." for advice in explanation.advice)


def _missing(missing: Missing) -> str:
    lines = [f"- **{missing.headline}**", f"  - At stage {missing.step}."]
    if missing.decisive is not None:
        lines.append(f"  - Decisive: {missing.decisive.sentence}")
    if missing.next_best:
        lines.append(f"  - Next best: {missing.next_best}")
    if missing.by_snapshot:
        lines.append(f"  - By snapshot: {missing.by_snapshot}")
    return "\n".join([*lines, *(f"  - What helps: {advice}." for advice in missing.advice)])
