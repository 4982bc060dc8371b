"""Stored runs of earlier versions of a problem, which answer its cells if the manifest says what they mean."""

import sys
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import islice

from sqlalchemy import Connection

from drivecal.bundles.archives import MANIFEST, files_of
from drivecal.bundles.manifest import Manifest
from drivecal.bundles.shapes import with_coefficients
from drivecal.campaigns.resolve.bench import Bench
from drivecal.domain.campaigns import StageName
from drivecal.domain.errors import InvalidInputError
from drivecal.domain.evaluations import Donor
from drivecal.domain.parameters import ParameterSet, ParameterSpace
from drivecal.domain.values import Setting, Value, decimal
from drivecal.storage import bundles
from drivecal.storage.references import parameter_sets, runs, setups
from drivecal.storage.references.runs import RatedRun

SAMPLE = 12
"""Stored cells of an earlier version that are simulated again, before others answer cells; at least one in each of its scenarios."""
MOST_SCENARIOS = 20


@dataclass(frozen=True)
class EarlierVersion:
    """An earlier version of a problem, with the claims that make its runs answers of the present one."""

    manifest: Manifest
    kept: Mapping[str, str]
    """Earlier names by the present ones, in the present order."""
    added: Mapping[str, Value]
    removed: Mapping[str, Value]

    @property
    def claims(self) -> tuple[str, ...]:
        """Fields of the manifest that claim something about it."""
        renamed = [f"renamed.{new}" for new, old in self.kept.items() if new != old]
        return (*(f"added.{name}" for name in self.added), *(f"removed.{name}" for name in self.removed), *renamed)

    def before(self, present: ParameterSet) -> ParameterSet | None:
        """Returns the earlier set whose runs answer a present one; None if the claims speak of other values."""
        values = present.values
        if any(values.get(name) != value for name, value in self.added.items()):
            return None
        return ParameterSet.of({old: values[new] for new, old in self.kept.items()} | dict(self.removed))

    def after(self, earlier: ParameterSet, names: tuple[str, ...]) -> ParameterSet | None:
        """Returns the present set, in the order of `names`, that an earlier one answers; None if the claims speak of other sets."""
        values = earlier.values
        if values.keys() != {*self.kept.values(), *self.removed}:
            return None
        if any(values[name] != value for name, value in self.removed.items()):
            return None
        present = {new: values[old] for new, old in self.kept.items()} | dict(self.added)
        return ParameterSet.of({name: present[name] for name in names})


def earlier_version(manifest: Manifest, earlier: Manifest) -> EarlierVersion | None:
    """Returns an earlier version of a problem with other parameters; None if the claims leave a difference open."""
    names, before, renamed = list(manifest.scalars), set(earlier.scalars), dict(manifest.renamed)
    for name, shape in manifest.shapes.items():
        old = renamed.pop(name, name)
        renamed |= {each: old + each.removeprefix(name) for each in shape.names}
    kept = {name: renamed.get(name, name) for name in names}
    kept = {name: name if name in before else old for name, old in kept.items() if name in before or old in before}
    now, then = manifest.coefficients, earlier.coefficients
    if any(now.get(new) != then.get(old) for new, old in kept.items()):  # a coefficient has no other meaning
        return None
    added, removed = set(names) - kept.keys(), before - set(kept.values())
    if not (added or removed or any(new != old for new, old in kept.items())):
        return None
    try:
        new = with_coefficients(manifest.added, manifest.shapes, "added")
        gone = with_coefficients(manifest.removed, earlier.shapes, "removed")
    except InvalidInputError:  # another version's curve
        return None
    if len(set(kept.values())) < len(kept) or not (added <= new.keys() and removed <= gone.keys()):
        return None
    return EarlierVersion(manifest=earlier, kept=kept, added=_exact(new, added), removed=_exact(gone, removed))


def _exact(claimed: Mapping[str, Setting], names: set[str]) -> dict[str, Value]:
    return {name: value if isinstance(value, str) else decimal(value) for name, value in claimed.items() if name in names}


def bench_of(version: EarlierVersion, bench: Bench) -> Bench:
    """Returns the bench whose setups runs of an earlier version have."""
    return replace(bench, earlier=version.manifest)


def present_version(bench: Bench) -> EarlierVersion:
    """Returns the present version, whose runs answer its own cells."""
    return EarlierVersion(bench.bundle.manifest, {each.name: each.name for each in bench.parameters}, {}, {})


def checked_cells(connection: Connection, bench: Bench) -> list[tuple[str, ParameterSet]]:
    """Returns the cells of the present parameters that campaigns simulated to check claims."""
    settings = bench.evaluator_id, sys.maxsize, MOST_SCENARIOS, StageName.CLAIMS
    known, names = _setup_ids(connection, bench).items(), {each.name for each in bench.parameters}
    cells = ((name, run.parameters) for name, number in known for run in runs.rated(connection, number, *settings))
    return [cell for cell in cells if cell[1].values.keys() == names]


def earlier_versions(connection: Connection, bench: Bench) -> tuple[EarlierVersion, ...]:
    """Returns the pushed versions of a problem whose runs its manifest speaks of, last pushed first."""
    manifest = bench.bundle.manifest
    if not manifest.claims:
        return ()
    versions: dict[object, EarlierVersion] = {}
    for document in bundles.manifests(connection, manifest.problem).values():
        version = earlier_version(manifest, Manifest.model_validate(document))
        if version is not None:
            versions.setdefault((frozenset(version.manifest.parameters), bench_of(version, bench).fingerprints), version)
    return tuple(versions.values())


def unclaimed(connection: Connection, digest: str, manifest: Manifest) -> list[str]:
    """Returns notes on the differences from the push before for which its runs answer nothing: files, and parameters without a claim."""
    pushed = bundles.manifests(connection, manifest.problem)
    before = next(islice(pushed, 1 + list(pushed).index(digest), None), None) if digest in pushed else None
    if before is None:
        return []
    earlier = Manifest.model_validate(pushed[before])
    now, then = (files_of(bundles.archive(connection, each)) for each in (digest, before))
    changed = [name for name in sorted({*now, *then} - {MANIFEST}) if now.get(name) != then.get(name)]
    claimed = {*manifest.added, *manifest.removed, *manifest.renamed, *manifest.renamed.values()}
    notes = [
        f"parameters.{name} is {'new' if name in manifest.parameters else 'gone'}: runs of the push before answer nothing without"
        " `added: {NAME: VALUE}`, `removed` or `renamed` in problem.yaml"
        for name in sorted((manifest.parameters.keys() ^ earlier.parameters.keys()) - claimed)
    ]
    return notes + ([f"{', '.join(changed[:5])} changed: runs of the push before answer nothing"] if changed else [])


def sample(
    connection: Connection, bench: Bench, versions: Collection[EarlierVersion], space: ParameterSpace, watermark: int
) -> list[tuple[EarlierVersion, str, ParameterSet]]:
    """Returns the cells that check claims: the same for every campaign, as far as its space and scenarios hold them."""
    cells = []
    for version in versions:
        known = _setup_ids(connection, bench_of(version, bench))
        for scenario, setup_id in islice(known.items(), max(1, MOST_SCENARIOS // len(versions))):
            stored = _answering(connection, bench, version, setup_id, space, watermark)
            cells += [(version, scenario, each) for each in islice(stored, max(1, SAMPLE // len(known)))]
    return cells


def _answering(
    connection: Connection, bench: Bench, version: EarlierVersion, setup_id: int, space: ParameterSpace, watermark: int
) -> Iterator[ParameterSet]:
    """Yields the sets in the space that an earlier version's runs in a setup answer, in a random order that is always the same."""
    names = {*version.kept.values(), *version.removed}
    others = {*version.kept, *version.added} - names
    for run in runs.in_order_of_keys(connection, setup_id, bench.evaluator_id, watermark, names, others):
        present = version.after(run.parameters, space.names)
        if present is not None and place_in(space, present) is not None:
            yield present


def place_in(space: ParameterSpace, parameters: ParameterSet) -> tuple[int, ...] | None:
    """Returns the grid indices of a set in a space; None if it lies outside."""
    try:
        return tuple(space.indices(parameters.values))
    except InvalidInputError:
        return None


def answers_of(
    connection: Connection,
    bench: Bench,
    versions: Collection[EarlierVersion],
    wanted: Collection[tuple[str, ParameterSet]],
    watermark: int,
) -> dict[tuple[str, ParameterSet], Donor]:
    """Returns the stored answers of cells by runs of earlier versions, by scenario and set; the newest version comes first."""
    answers: dict[tuple[str, ParameterSet], Donor] = {}
    for version in versions:
        before = {cell: earlier for cell in wanted if cell not in answers and (earlier := version.before(cell[1])) is not None}
        ids = parameter_sets.ids(connection, [each.key for each in before.values()])
        known = _setup_ids(connection, bench_of(version, bench)) if ids else {}
        for scenario, setup_id in known.items():
            sets = {ids[each.key]: cell for cell, each in before.items() if cell[0] == scenario and each.key in ids}
            donors = runs.look_up_exact(connection, setup_id, list(sets), bench.evaluator_id, watermark)
            answers |= {sets[number]: donor for number, donor in donors.items()}
    return answers


def rated(
    connection: Connection, bench: Bench, versions: Collection[EarlierVersion], scenario: str, watermark: int, limit: int
) -> list[RatedRun]:
    """Returns the last runs of a scenario up to `watermark`, in the order of references, runs of earlier versions first.

    Args:
        connection: the database.
        bench: the campaign's bench.
        versions: earlier versions whose claims are checked.
        scenario: id of the scenario.
        watermark: largest number of a run.
        limit: most runs of each version.
    """
    names = tuple(parameter.name for parameter in bench.parameters)
    known, own = _setup_ids(connection, bench), list[RatedRun]()
    if scenario in known:
        own = runs.rated(connection, known[scenario], bench.evaluator_id, watermark, limit)
    seen, earlier = {run.parameters for run in own}, list[RatedRun]()
    for version in versions:
        known = _setup_ids(connection, bench_of(version, bench))
        for run in runs.rated(connection, known[scenario], bench.evaluator_id, watermark, limit) if scenario in known else ():
            present = version.after(run.parameters, names)
            if present is not None and present not in seen:
                seen.add(present)
                earlier.append(replace(run, parameters=present))
    return [*earlier, *own]


def _setup_ids(connection: Connection, bench: Bench) -> dict[str, int]:
    """Returns the numbers of the stored setups by scenario."""
    known = setups.ids(connection, [setup.fingerprint for setup in bench.setups.values()])
    return {name: known[setup.fingerprint] for name, setup in bench.setups.items() if setup.fingerprint in known}
