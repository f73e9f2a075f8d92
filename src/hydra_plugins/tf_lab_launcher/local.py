"""`hydra/launcher=tf_lab`: the jobs of a sweep as processes of this machine; and its sweeper.

Hydra executes this at every start of every command, before the module is known by its name (so
dataclasses cannot have annotations from __future__): all that takes time is imported when it runs.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pkgutil import resolve_name

from hydra._internal.core_plugins.basic_sweeper import BasicSweeper, BasicSweeperConf
from hydra.core.config_store import ConfigStore
from hydra.core.utils import JobReturn
from hydra.plugins.launcher import Launcher
from hydra.types import HydraContext, TaskFunction
from omegaconf import II, DictConfig


@dataclass
class LocalLauncherConf:
    """Its settings in Hydra's config.

    Attributes:
        jobs: at a time.
    """

    _target_: str = "hydra_plugins.tf_lab_launcher.local.LocalLauncher"
    jobs: int = II("launcher.jobs")


ConfigStore.instance().store(
    group="hydra/launcher", name="tf_lab", node=LocalLauncherConf, provider="tf_lab"
)


@dataclass
class LocalSweeperConf(BasicSweeperConf):
    """Settings of Hydra's own sweeper."""

    _target_: str = "hydra_plugins.tf_lab_launcher.local.LocalSweeper"


ConfigStore.instance().store(
    group="hydra/sweeper", name="tf_lab", node=LocalSweeperConf, provider="tf_lab"
)


class LocalSweeper(BasicSweeper):
    """Hydra's, which composes every job to see that it can be, and the launcher does so again.

    Ours composes all before the first starts, so once will do.
    """

    def validate_batch_is_legal(self, batch: Sequence[Sequence[str]]) -> None:
        """Leave it to the launcher."""


class LocalLauncher(Launcher):
    """Runs so many jobs at a time, each as a process of its own; see `run_jobs`."""

    def __init__(self, jobs: int = 1) -> None:
        self.jobs = jobs

    def setup(
        self, *, hydra_context: HydraContext, task_function: TaskFunction, config: DictConfig
    ) -> None:
        """Called by Hydra before `launch`."""
        self.context, self.task, self.config = hydra_context, task_function, config

    def launch(
        self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int
    ) -> Sequence[JobReturn]:
        """Run the jobs; a failed one is in the sweep's table and does not end the others."""
        from hydra.core.utils import JobStatus, configure_log, setup_globals
        from omegaconf import open_dict

        from tf_lab.experiments.launcher import run_jobs

        setup_globals()
        configure_log(self.config.hydra.hydra_logging, self.config.hydra.verbose)

        def composed(number: int, overrides: Sequence[str]) -> DictConfig:
            cfg = self.context.config_loader.load_sweep_config(self.config, list(overrides))
            with open_dict(cfg.hydra.job):
                cfg.hydra.job.id, cfg.hydra.job.num = str(number), number
            return cfg

        configs = [composed(*job) for job in enumerate(job_overrides, initial_job_idx)]
        jobs = getattr(self.task, "jobs")  # noqa: B009  # see `tf_lab.cli.command`
        run_jobs(resolve_name(jobs), configs, self.jobs)
        return [
            JobReturn(overrides=list(overrides), status=JobStatus.COMPLETED)
            for overrides in job_overrides
        ]
