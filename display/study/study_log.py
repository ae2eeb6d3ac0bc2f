"""Recording of a play's trials into the file of a study, as they end."""

from __future__ import annotations

import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from assets.file_access import check_writable
from core.errors import BadInput
from display.protocol import Frame, WorldView
from display.study.study_file import add_to_study, read_study
from display.study.trial import Trial, TrialMeter
from display.user_commands import PlayDemo, Reset, last_of

MIN_SECONDS = 1.0  # a shorter trial without any grip was none


class StudyLog:
    """`after` each frame, `close` at the end: each trial is written once it ends.

    A trial begins with the play and with each reset. It ends when the score has reached the game's goal, and otherwise
    with the next reset, a demonstration, or the play. Raises BadInput at once if `path` cannot be written; if that
    happens later, a line says so and the play goes on.
    """

    def __init__(self, path: str | Path, *, participant: str, task: str, device: str, about: dict):
        self.path = Path(path)
        check_writable(self.path)
        if self.path.exists():
            read_study(self.path)
        self._new = {"participant": participant, "task": task, "device": device, "about": about}
        self._meter: TrialMeter | None = None
        self._writer, self._begun = ThreadPoolExecutor(1), False

    def __enter__(self) -> StudyLog:
        return self

    def __exit__(self, *error) -> None:
        self.close()

    def after(self, frame: Frame, world: WorldView) -> None:
        """Take account of a frame, after the world's step."""
        demo = last_of(PlayDemo, frame.commands)
        restarts = last_of(Reset, frame.commands) is not None
        if restarts or demo is not None:
            self._end()
        if restarts or not self._begun:
            goal = getattr(world.scene.game, "goal", None)
            self._meter, self._begun = TrialMeter(Trial(**self._new), goal), True
        if world.demo:  # the scripted hand is no participant
            self._meter = None
        if self._meter is not None:
            self._meter.after(frame, world)
            if self._meter.over:
                self._end()

    def _end(self) -> None:
        """Write the trial, if there is one: in a thread, since it takes longer than a frame."""
        meter, self._meter = self._meter, None
        trial = None if meter is None else meter.trial()
        if trial is not None and (trial.grips or trial.seconds >= MIN_SECONDS):
            self._writer.submit(self._write, trial)

    def _write(self, trial: Trial) -> None:
        try:
            study = add_to_study(self.path, lambda study: study.trials.append(trial))
        except BadInput as e:
            print(f"vrgs: a trial is lost: {e}", file=sys.stderr)
            return
        print(f"{self.path}: {summary(trial)}; trial {len(study.trials)}", file=sys.stderr)

    def close(self) -> None:
        """End the trial, and wait until all is written. Further calls do nothing."""
        self._end()
        self._writer.shutdown()


def summary(trial: Trial) -> str:
    """A trial in half a line."""
    who = f"{trial.participant}, " if trial.participant else ""
    goal = " (goal reached)" if trial.completed else ""
    return (
        f"{who}{trial.task}, {trial.setting}: score {trial.score:g}{goal} in {trial.seconds:.1f} s, {trial.grips} grips"
    )
