"""What every reader must do: what is there is told and read, and damage is named."""

from __future__ import annotations

import contextlib
import itertools
import pickle
import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import voluminous as vm
from voluminous.io import find_reader, open
from voluminous.io.registry import open_lazily


class ReaderContract:
    """A sound file is read as its reader tells; a damaged one gives an error of voluminous.

    A subclass gives the fixture ``sample``: a function of a new directory, which writes a small
    file of the format there and returns its path. What has to be damaged (in a format of several
    files) are the paths that `victims` returns, and `options` are given to `open`.
    """

    options: dict = {}  # noqa: RUF012
    cuts = (0.0, 0.3, 0.9)

    def victims(self, path: Path) -> list[Path]:
        """Return the files to damage."""
        return [path]

    @pytest.fixture
    def path(self, sample, tmp_path):
        return sample(tmp_path)

    def test_the_reader_is_found_by_content(self, path):
        assert find_reader(path) is self.reader(path)

    def reader(self, path):
        """Return the reader that should be found; by default any but the general ones."""
        return find_reader(path)

    def test_what_is_told_is_what_is_read(self, path):
        told = find_reader(path).info(path, **self.options)
        volume = open(path, **self.options)
        assert volume.fields
        assert {field.name for field in told} >= set(volume.fields)
        by_name = {field.name: field for field in told}
        for name in volume.fields:
            assert by_name[name].unit == volume.units[name]

    def test_one_field_is_read_alone(self, path):
        volume = open(path, **self.options)
        name = volume.fields[-1]
        alone = open(path, name, **self.options)
        assert alone.fields == (name,)
        np.testing.assert_array_equal(alone.array(name), volume.array(name))
        place = {f.name: f.place for f in find_reader(path).info(path, **self.options)}[name]
        renamed = open(path, {"other": place}, **self.options)
        np.testing.assert_array_equal(renamed.array("other"), volume.array(name))
        with pytest.raises(vm.errors.UnknownNameError):
            open(path, "no_such_field", **self.options)

    def test_it_goes_to_processes_that_stand_elsewhere(self, path, tmp_path_factory, monkeypatch):
        """Nothing is read before it is there; of what was read, the arrays go."""
        monkeypatch.chdir(path.parent)
        volume = open_lazily(path.name, **self.options)
        sent, told = pickle.dumps(volume.unread()), volume.fingerprint()
        expected = {name: volume.array(name) for name in volume.fields}
        again = pickle.dumps(volume.unread())
        monkeypatch.chdir(tmp_path_factory.mktemp("elsewhere"))
        for other in map(pickle.loads, (sent, again)):
            assert other.fingerprint() == told
            for name, values in expected.items():
                np.testing.assert_array_equal(other.array(name), values)

    def test_cut_short(self, path):
        for victim, part in itertools.product(self.victims(path), self.cuts):
            content = victim.read_bytes()
            victim.write_bytes(content[: int(part * len(content))])
            with pytest.raises(vm.FileFormatError) as failure:
                open(path, **self.options)
            assert path.name in str(failure.value)
            victim.write_bytes(content)

    @pytest.mark.exhaustive
    def test_damaged_bytes_give_our_errors_only(self, sample, tmp_path):
        clean = sample(tmp_path)
        victims = self.victims(clean)

        @settings(
            max_examples=150, deadline=None, suppress_health_check=list(HealthCheck), database=None
        )
        @given(data=st.data())
        def run(data):
            victim = data.draw(st.sampled_from(victims))
            good = victim.with_name(victim.name + ".good")
            shutil.copy(victim, good)
            content = bytearray(victim.read_bytes())
            # Heads are short and worth more: half of all damage is done to the first bytes.
            limit = data.draw(st.sampled_from([min(512, len(content)), len(content)]))
            way = data.draw(st.sampled_from(["bytes", "bits", "zeros", "cut"]))
            for _ in range(data.draw(st.integers(1, 4))):
                at = data.draw(st.integers(0, limit - 1))
                if way == "bytes":
                    content[at] = data.draw(st.integers(0, 255))
                elif way == "bits":
                    content[at] ^= 1 << data.draw(st.integers(0, 7))
                elif way == "zeros":
                    content[at : at + 16] = bytes(len(content[at : at + 16]))
                else:
                    limit = max(at, 1)
                    del content[limit:]
            victim.write_bytes(content)
            try:
                with contextlib.suppress(vm.VoluminousError):
                    open(clean, **self.options)
            finally:
                good.replace(victim)

        run()
