# SPDX-License-Identifier: Apache-2.0
"""Progress of a run that has placed nothing."""

from collections.abc import Iterator

from multilica.results.document import ResultDocument
from multilica.results.document.stages import StageFigures, VerifyFigures


def progress_sentence(document: ResultDocument) -> str:
    """Return where the run ended."""
    progress = document.progress
    after = f"after stage {progress.finished[-1]}" if progress and progress.finished else "before any stage finished"
    during = f", in stage {progress.running}" if progress and progress.running else ""
    return f"The run was cut off {after}{during}. No LiDAR is placed yet."


def known_so_far(document: ResultDocument) -> Iterator[str]:
    """Yield the figures of the last stage of pairs and the merge steps; before there are pairs, those per LiDAR."""
    if document.pairs and (document.stages is None or document.stages.fine is None):
        for pair in document.pairs:
            yield f"{pair.target} <- {pair.source}: {pair.verdict.outcome}, fitness {pair.fitness or 0.0:.2f}."
    elif document.stages is not None:
        yield from _last_figures(document.stages)
        for step, figures in enumerate((document.stages.merge or {}).values(), start=1):
            groups = figures.groups.replace("; ", ", ")
            yield f"Merge step {step}: merged {figures.chosen or 'nothing'}. Groups: {groups}."


def _last_figures(stages: StageFigures) -> Iterator[str]:
    if stages.fine is not None:
        for pair, fine in stages.fine.items():
            yield f"{pair}: {fine.verdict}, fitness {fine.fitness or 0.0:.2f}."
    elif stages.verify is not None:
        for pair, verified in stages.verify.items():
            yield f"{pair}: {_verified(verified)}."
    elif stages.coarse is not None:
        for pair, coarse in stages.coarse.items():
            yield f"{pair}: {coarse.hypotheses} hypotheses."
    elif stages.correspond is not None:
        for pair, matched in stages.correspond.items():
            yield f"{pair}: {matched.matches} matches."
    else:
        for name, cloud in (stages.preprocess or {}).items():
            yield f"{name}: {cloud.points:,} points after preprocessing."


def _verified(figures: VerifyFigures) -> str:
    if not figures.distinct:
        return "no pose"
    best = f"{figures.agree} points agree, {figures.violate} are in empty space"
    return f"{figures.distinct} distinct poses, and at the best {best}"
