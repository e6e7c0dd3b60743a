"""Where a run in blocks is: one count of steps over all of its stages."""

from splatproof.methods.city.settings import CitySettings
from splatproof.methods.contracts.run import Run


class Progress:
    """One count of steps over coarse model, blocks and refinement, for the run's report."""

    def __init__(self, run: Run, settings: CitySettings, views: int) -> None:
        """Start at nothing.

        Args:
            run: Whose report is called.
            settings: Say how many steps there will be.
            views: Number of training views of the whole scene.
        """
        self.report = run.report
        self.blocks = [0] * settings.blocks
        self.gaussians = [0.0] * settings.blocks
        self.before = settings.coarse_iterations
        each = settings.iterations
        after = settings.refine.steps(settings, views) if settings.gcr else 0
        self.total = self.before + each * settings.blocks + after
        self.after = self.before + each * settings.blocks

    def coarse(self, step: int, total: int, values: dict[str, float]) -> None:
        """Report a step of the coarse model.

        Args:
            step: Steps of the coarse model that are done.
            total: Not looked at: the run's own total is reported.
            values: What the report says: loss, terms, number of Gaussians.
        """
        del total
        self.report(step, self.total, values)

    def block(self, index: int, step: int, total: int, values: dict[str, float]) -> None:
        """Report a step of a block; Gaussians are those of all blocks so far together.

        Args:
            index: Number of the block.
            step: Steps of the block that are done.
            total: Not looked at: the run's own total is reported.
            values: What the report says of the block; with "gaussians".
        """
        del total
        self.blocks[index] = step
        self.gaussians[index] = values["gaussians"]
        together = values | {"gaussians": sum(self.gaussians)}
        self.report(self.before + sum(self.blocks), self.total, together)

    def parts(self, step: int, total: int, values: dict[str, float]) -> None:
        """Report a step of a refinement in parts, which together count as many steps as the whole one would.

        Args:
            step: Steps of all parts that are done.
            total: Steps of all parts.
            values: What the report says of the part that made one: loss, terms, number of Gaussians.
        """
        self.report(self.after + (self.total - self.after) * step // total, self.total, values)

    def refine(self, step: int, total: int, values: dict[str, float]) -> None:
        """Report a step of the refinement.

        Args:
            step: Steps of the refinement that are done.
            total: Not looked at: the run's own total is reported.
            values: What the report says: loss, terms, number of Gaussians.
        """
        del total
        self.report(self.after + step, self.total, values)
