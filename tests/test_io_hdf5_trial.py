"""Files that make libhdf5 crash or hang: another process finds out."""

import os
import signal
import time
from pathlib import Path

import h5py
import numpy as np
import pytest

import voluminous as vm
from voluminous.io.hdf5 import check, opened, trial, trial_child
from voluminous.io.hdf5.trial import Looker

posix = pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="Windows has no SIGPROF")


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "field.h5"
    with h5py.File(path, "w") as file:
        file.attrs["name"] = "a cube"
        file["group/rho"] = np.ones((2, 3, 4))
        file["group/texts"] = ["a", "bc"]
    return path


def looker(tmp_path, what):
    """Return a looker whose process does something else; well for names with 'well' in it."""
    script = tmp_path / "child.py"
    lines = ["import os, signal, sys, time", "for line in sys.stdin:", "    if 'well' not in line:"]
    script.write_text("\n".join([*lines, f"        {what}", "    os.write(1, b'..\\n')"]))
    return Looker(str(script))


class TestSound:
    def test_a_sound_file_is_opened(self, path):
        with opened(path) as file:
            assert file["group/rho"].shape == (2, 3, 4)

    def test_a_file_that_is_missing_is_for_others_to_explain(self, tmp_path):
        check(tmp_path / "none.h5")
        with pytest.raises(FileNotFoundError), opened(tmp_path / "none.h5"):
            pass

    def test_what_is_no_hdf5_is_for_others_to_explain(self, tmp_path):
        (tmp_path / "text.h5").write_text("no numbers")
        check(tmp_path / "text.h5")

    def test_groups_in_a_circle_have_an_end(self, path):
        with h5py.File(path, "a") as file:
            file["group/again"] = file["/"]
        looked = []
        trial_child.look_through(str(path), lambda: looked.append(1))
        assert 4 <= len(looked) <= 10

    def test_links_to_other_files_are_not_followed(self, path, tmp_path):
        with h5py.File(path, "a") as file:
            file["other"] = h5py.ExternalLink(str(tmp_path / "away.h5"), "/")
            file["soft"] = h5py.SoftLink("/nowhere")
        check(path)

    def test_a_great_number_of_objects_takes_bounded_time(self, path, monkeypatch):
        monkeypatch.setattr(trial_child, "LONGEST", 0.0)
        looked = []
        trial_child.look_through(str(path), lambda: looked.append(1))
        assert looked == [1]  # no object was looked at


class TestDamaged:
    def test_a_crash_is_named(self, tmp_path):
        assert "crashes" in looker(tmp_path, "os.abort()").look("bad")

    @posix
    def test_a_search_without_end_is_ended(self, tmp_path):
        endless = "signal.setitimer(signal.ITIMER_PROF, 0.1)\n        while True: pass"
        assert "come to an end" in looker(tmp_path, endless).look("bad")

    @posix
    def test_looking_through_a_file_in_this_process_sets_no_clock(self, path):
        trial_child.look_through(str(path), lambda: None)
        assert signal.getitimer(signal.ITIMER_PROF) == (0.0, 0.0)

    @posix
    def test_the_child_ends_itself_over_an_object_that_takes_too_long(self, path, tmp_path):
        """The real child, with a look at an object that never ends, and little time for it."""
        script = tmp_path / "impatient.py"
        source = Path(trial_child.__file__).read_text()
        endless = "def _look(item: Any, size: int) -> None:\n    while True:\n        pass\n"
        source = source.replace("STEADY = 3.0", "STEADY = 0.2").replace(
            'if __name__ == "__main__"', endless + '\n\nif __name__ == "__main__"'
        )
        script.write_text(source)
        assert "come to an end" in Looker(str(script)).look(str(path))

    def test_silence_is_an_end_too(self, tmp_path, monkeypatch):
        monkeypatch.setattr(trial, "PATIENCE", 0.3)
        assert "come to an end" in looker(tmp_path, "time.sleep(60)").look("bad")

    def test_the_next_file_is_looked_at_by_a_new_process(self, tmp_path):
        child = looker(tmp_path, "os.abort()")
        assert child.look("well") == ""
        assert "crashes" in child.look("bad")
        assert child.look("well") == ""

    def test_an_attribute_larger_than_the_file(self, path, monkeypatch):
        with h5py.File(path, "a") as file:
            file["group"].attrs["large"] = np.zeros(700)
        trial_child.look_through(str(path), lambda: None)
        monkeypatch.setattr(os.path, "getsize", lambda path: 5000)
        with pytest.raises(trial_child.DamagedError, match="'large' of /group is larger than"):
            trial_child.look_through(str(path), lambda: None)

    def test_what_the_child_finds_is_told(self, tmp_path):
        found = "os.write(1, b'..the attribute is large\\n'); continue"
        assert looker(tmp_path, found).look("bad") == "the attribute is large"

    def test_the_error_names_the_file(self, path, monkeypatch):
        monkeypatch.setattr(trial, "_LOOKER", _Always("libhdf5 crashes"))
        os.utime(path, (1, 1))
        with pytest.raises(vm.FileFormatError, match=r"field\.h5.*libhdf5 crashes.*copy it again"):
            vm.open(path)
        with pytest.raises(vm.FileFormatError, match="libhdf5 crashes"):
            vm.open(path, format="hdf5")


class TestCost:
    def test_a_file_is_looked_at_once(self, path, monkeypatch):
        asked = []
        monkeypatch.setattr(trial, "_LOOKER", _Always("", asked))
        os.utime(path, (2, 2))
        vm.open(path)
        assert len(asked) == 1
        time.sleep(0.01)
        with h5py.File(path, "a") as file:
            file["more"] = np.ones((3, 3, 3))
        check(path)
        assert len(asked) == 2

    def test_where_python_cannot_be_started_files_are_opened_all_the_same(self, path, monkeypatch):
        monkeypatch.setattr("sys.executable", "/opt/viewer/bin/viewer")
        os.utime(path, (3, 3))
        assert not trial.can_start_python()
        assert "rho" in str(vm.open(path).fields)


class _Always:
    def __init__(self, answer, asked=None):
        self.answer, self.asked = answer, [] if asked is None else asked

    def look(self, path):
        self.asked.append(path)
        return self.answer
