"""Common part of the simulators' sections in a manifest: types of fields, and the settings of child processes."""

from typing import Annotated, Self

from pydantic import Field, StringConstraints, model_validator

from drivecal.contracts.specification import Model
from drivecal.contracts.strict_json import Identifier

Text = Annotated[str, StringConstraints(max_length=1000)]
Unit = Annotated[str, StringConstraints(max_length=32)]
File = Annotated[str, StringConstraints(min_length=1, max_length=255)]
"""Path inside the bundle, with forward slashes."""
Command = Annotated[list[Annotated[str, StringConstraints(min_length=1, max_length=4096)]], Field(min_length=1, max_length=100)]

Path = Annotated[str, StringConstraints(min_length=2, max_length=255, pattern=r"^/[^\x00-\x1f]*$")]
"""A whole path on the workers."""
Variable = Annotated[str, StringConstraints(min_length=1, max_length=255, pattern=r"^[A-Za-z_][A-Za-z0-9_]*$")]
"""Name of an environment variable."""


Resources = Annotated[dict[Identifier, Annotated[int, Field(ge=0, le=10_000)]], Field(max_length=20)]
"""Number of each scarce thing that a run holds, such as licences, by name."""


class SimulatorEntry(Model):
    """Settings of every simulator that runs in child processes.

    `timeout` (s, wall-clock) and `memory_mb` limit each run. `deterministic`: the simulator claims equal measures for equal inputs.
    `probe`: a command whose output is the version of tools outside of the bundle.
    `environment`: names of further variables that its processes get from the worker.
    `inputs` lists files, folders and commands outside of the bundle.
    """

    timeout: Annotated[float, Field(gt=0, le=86_400)] = 60.0
    """Longest run, s of wall-clock time."""
    memory_mb: Annotated[int, Field(ge=16, le=1_000_000)] = 2000
    """Memory limit of a run's processes, MB."""
    deterministic: bool = False
    """Equal inputs give equal measures."""
    random: bool = False
    """The measures depend on the `seed` of a request as well."""
    probe: Command | None = None
    """A command that prints the version of tools outside of the folder."""
    environment: Annotated[list[Variable], Field(max_length=50)] | None = None
    """Names of further variables that the processes get from the worker; a digest of each value is in the key of stored runs."""
    inputs: Annotated[list[Path | Command], Field(max_length=50)] | None = None
    """Files and folders outside of the folder, as whole paths, and commands; the keys of runs have a digest of each content or output."""
    resources: Resources | None = None
    """Licences and other scarce things that a run holds, by name; the server counts them (`drivecal serve --resources`)."""

    @model_validator(mode="after")
    def _is_random_or_not(self) -> Self:
        if self.random and self.deterministic:
            raise ValueError("it is random and deterministic; give one of them, or neither if you do not know")
        return self

    @property
    def asks_workers(self) -> bool:
        """True if a run depends on what only workers know: the probe's answer, values of variables, or inputs."""
        return bool(self.probe or self.environment or self.inputs)

    @property
    def renews(self) -> bool:
        """True if each run has a new process."""
        return not getattr(self, "reset", True)
