"""Validation of the reduction: Tables 1 and 2 of the paper, and Figure 14, the histogram of deviations."""

import math
from collections.abc import Iterator, Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator, NullFormatter, StrMethodFormatter

from drivecal.contracts.tables import InfluenceRow, ValidationRow
from drivecal.domain.scales import COMFORT, Scale, unit_text
from drivecal.report.data import Studied
from drivecal.report.figures.drawing import BLUE, INK, VERMILION, Drawn, style
from drivecal.report.markup import paragraph, table
from drivecal.report.rows import PREDICTIONS, errors_text, interval_text, percent, predictions, totals

PANELS_PER_SHEET = 12
MOST_COLUMNS = 15
"""Differences that the table lists even if no variant has them."""


def reducible(rows: Sequence[InfluenceRow]) -> list[str]:
    """Returns the parameters of one scenario with a non-influential region of more than one value."""
    parameters = []
    for row in rows:
        if row.space_lower is None or row.space_upper is None or row.n_values is None:
            continue
        if not row.influential:
            regions = [row.n_values]
        else:
            step = (row.space_upper - row.space_lower) / (row.n_values - 1)
            below = 0.0 if row.lower is None else row.lower - row.space_lower
            above = 0.0 if row.upper is None else row.space_upper - row.upper
            regions = [round(below / step), round(above / step)]
        if max(regions) > 1:
            parameters.append(row.parameter)
    return parameters


def drawn(rows: Sequence[ValidationRow], scale: Scale = COMFORT) -> Iterator[Drawn]:
    """Yields the sheets of Figure 14; none if nothing was compared."""
    compared = [row for row in rows if row.compared]
    caption = (
        "How far the scores of variants, which differ from a basis only where the map says that it does not matter, are from "
        "the score of the basis; on a logarithmic scale, or all but the zeros would be invisible. Hatched: by more than "
        f"{scale.amount(scale.tolerance)}, wrong."
    )
    for number, start in enumerate(range(0, len(compared), PANELS_PER_SHEET), 1):
        sheet = compared[start : start + PANELS_PER_SHEET]
        alt = "; ".join(
            f"{row.scenario}: {row.compared - row.different:,} of {row.compared:,} unchanged, {row.wrong:,} wrong"
            for row in sheet
        )
        name = "figure-14-validation" if number == 1 else f"figure-14-validation-{number}"
        yield Drawn(name, caption, validation_figure(sheet, scale), alt=f"Histograms of deviations. {alt}.")


def validation_figure(rows: Sequence[ValidationRow], scale: Scale = COMFORT) -> Figure:
    """Draws a histogram per scenario of the differences between variants and their bases, in units of the score."""
    bins = _bins(rows, scale)
    last, width = bins[-1] * rows[0].histogram_step, rows[0].histogram_step
    columns = min(3, len(rows))
    lines = math.ceil(len(rows) / columns)
    top = max(max(row.histogram.values(), default=1) for row in rows)
    with style():
        figure = Figure(figsize=(max(3.6, 2.47 * columns), 0.5 + 1.75 * lines), layout="constrained")
        panels = figure.subplots(lines, columns, squeeze=False, sharex=True, sharey=True)
        for place, axes in enumerate(panels.flat):
            if place >= len(rows):
                axes.set_axis_off()
                continue
            _panel(axes, rows[place], scale)
            axes.set(yscale="log", ylim=(0.7, 2.5 * top), xlim=(-last - 0.6 * width, last + 0.6 * width))
            axes.xaxis.set_major_locator(MaxNLocator(8, integer=scale.is_whole, symmetric=True))
            axes.yaxis.set_major_formatter(StrMethodFormatter("{x:,.0f}"))
            axes.yaxis.set_minor_formatter(NullFormatter())
            axes.grid(visible=False, axis="x")
        figure.supxlabel(f"difference from the basis{unit_text(scale.unit, ', ')}", fontsize=8)
        figure.supylabel("variants", fontsize=8)
        handles = [
            Patch(facecolor=BLUE, edgecolor=INK, linewidth=0.4, label=f"up to {scale.amount(scale.tolerance)}"),
            Patch(facecolor=VERMILION, edgecolor="white", hatch="////", linewidth=0.4, label="wrong"),
        ]
        figure.legend(handles=handles, loc="outside upper right", ncols=2)  # below it would lie on the label
    return figure


def _panel(axes: Axes, row: ValidationRow, scale: Scale) -> None:
    for number, count in row.histogram.items():
        if not count:
            continue
        difference = number * row.histogram_step
        wrong = scale.is_wrong(difference)
        colour, hatch = (VERMILION, "////") if wrong else (BLUE, None)
        (bar,) = axes.bar(difference, count, width=0.85 * row.histogram_step, color=colour, hatch=hatch)
        bar.set(edgecolor="white" if wrong else INK, linewidth=0.4, gid=f"{row.scenario}.{number}")
    rate = "" if row.error_rate is None else f": {row.different / row.compared:.1%} differ, R_err {row.error_rate:.2%}"
    axes.set_title(f"{row.scenario}{rate}")


def parts(
    studied: Studied[ValidationRow],
    campaign: str,
    by_scenario: dict[str, list[InfluenceRow]],
    drawings: Sequence[str],
    scale: Scale = COMFORT,
) -> list[str]:
    """Returns the section: the comparison, Tables 1 and 2, the figure."""
    rows = studied.rows
    compared, different, wrong = totals(rows, "compared", "different", "wrong")
    text = (
        "Sets were drawn from Latin hypercubes until those that lie in some non-influential region covered the main effects and "
        "interactions of the reducible parameters; each was compared with variants that differ from it inside such regions only. "
    )
    text += errors_text("variants", compared, different, wrong, scale) if compared else ""
    if studied.study.campaign != campaign:
        text += f" Campaign {studied.study.campaign} made this study."
    nothing = [row.scenario for row in rows if not row.compared]
    if nothing:
        text += f" There was nothing to validate in {', '.join(nothing)}."
    return [paragraph(text), _sizes(rows, by_scenario), _rates(rows), *drawings, _histograms(rows, scale)]


def _sizes(rows: Sequence[ValidationRow], by_scenario: dict[str, list[InfluenceRow]]) -> str:
    lines = [
        [
            row.scenario,
            " ".join(reducible(by_scenario.get(row.scenario, []))),
            row.reducible,
            row.effects,
            row.covered,
            row.drawn,
            row.bases,
            row.references,
            row.bases * row.references,
        ]
        for row in rows
    ]
    header = ["scenario", "reducible parameters", "n", "effects", "covered", "LHS", "n*_LHS", "n_ref", "n_validation"]
    caption = "Sample sizes: n reducible parameters have 2^n - 1 effects; n*_LHS of the LHS sets that qualify were compared"
    return table(header, lines, caption)


def _bins(rows: Sequence[ValidationRow], scale: Scale) -> range:
    """Numbers of the bars from the largest negative difference of the scale, or of a row, to the largest positive one."""
    usual = round(scale.span / rows[0].histogram_step)
    last = max([usual, *(abs(number) for row in rows for number in row.histogram)])
    return range(-last, last + 1)


def _difference(number: int, width: float, scale: Scale) -> str:
    """Returns the middle of a bar, or from where on it holds all differences."""
    is_outermost = width == scale.bin and abs(number) > scale.last_bar
    text = f"{math.copysign(scale.span, number) if is_outermost else number * width:+g}".replace("-", "\N{MINUS SIGN}")
    return f"beyond {text}" if is_outermost else text if number else "0"


def _histograms(rows: Sequence[ValidationRow], scale: Scale) -> str:
    compared = [row for row in rows if row.compared]
    if not compared:
        return ""
    bins: Sequence[int] = _bins(compared, scale)
    if len(bins) > MOST_COLUMNS:
        bins = sorted({0, *(number for row in compared for number in row.histogram)})
    lines = [[row.scenario, *(row.histogram.get(number, 0) for number in bins)] for row in compared]
    header = ["scenario", *(_difference(number, compared[0].histogram_step, scale) for number in bins)]
    return table(
        header, lines, f"Deviations in numbers: variants by their difference from the basis{unit_text(scale.unit, ', in ')}"
    )


def _rates(rows: Sequence[ValidationRow]) -> str:
    lines = [
        [
            *(row.scenario, row.compared, row.different, row.wrong),
            *(percent(share) for share in (row.error_rate, row.lower_95, row.upper_95)),
        ]
        for row in rows
    ]
    header = ["scenario", "compared", "different", "wrong", "R_err", "95 % from", "to"]
    caption = "Share of wrong answers with its 95 % interval"
    return table(header, lines, f"{caption}. {interval_text(rows)}" if any(row.compared for row in rows) else caption)


def validated_predictions(studied: Studied[ValidationRow], scale: Scale) -> list[str]:
    """Returns a table of released predictions that a study simulated afterwards, and its sum."""
    caption = "Released predictions, simulated afterwards; limit: of the expected number beyond the tolerance, for each prediction in a lot"
    content = [table(PREDICTIONS, predictions(studied.rows), caption)]
    compared, different, wrong = totals(studied.rows, "compared", "different", "wrong")
    return [*content, paragraph(errors_text("predictions", compared, different, wrong, scale))] if compared else content
