"""Result folders appear whole or not at all, and nobody's own files are lost."""
import signal
from contextlib import suppress
from pathlib import Path

import pytest

from mems_ins_fusion import results
from mems_ins_fusion.guard import INTERRUPTED, guarded, heard_interruption
from mems_ins_fusion.results import ResultError, result_folder, write_files


def write(path, text, **options):
    with result_folder(path, **options) as folder:
        (folder / 'report.json').write_text(text)


def test_result_takes_its_name_only_when_complete(tmp_path):
    with pytest.raises(RuntimeError), result_folder(tmp_path / 'out') as folder:
        (folder / 'report.json').write_text('half')
        assert not (tmp_path / 'out').exists()
        raise RuntimeError
    assert list(tmp_path.iterdir()) == []


def test_existing_result_stays_unless_overwriting_is_asked_for(tmp_path):
    out = tmp_path / 'deep' / 'out'
    write(out, 'first')
    with pytest.raises(ResultError, match='exists already; .* with --overwrite$'):
        write(out, 'second')
    assert (out / 'report.json').read_text() == 'first'
    write(out, 'second', overwrite=True)
    assert (out / 'report.json').read_text() == 'second'
    assert [p.name for p in out.parent.iterdir()] == ['out']


def test_folder_that_is_no_result_is_never_replaced(tmp_path):
    (tmp_path / 'thesis.txt').write_text('years of work')
    with pytest.raises(ResultError, match='holds other files'):
        write(tmp_path, 'x', overwrite=True)
    assert (tmp_path / 'thesis.txt').exists()


def test_empty_folder_is_filled(tmp_path):
    (tmp_path / 'out').mkdir()
    write(tmp_path / 'out', 'x')
    assert (tmp_path / 'out' / 'report.json').exists()


def names_seen(tmp_path, monkeypatch):
    """Write over a result, and look after each step of the file system whether it is there."""
    out, seen = tmp_path / 'out', []
    write(out, 'first')
    rename, exchange = Path.rename, results._exchange

    def looked(step):
        def then(*arguments):
            done = step(*arguments)
            seen.append((out / 'report.json').exists())
            return done
        return then
    monkeypatch.setattr(Path, 'rename', looked(rename))
    monkeypatch.setattr(results, '_exchange', looked(exchange))
    write(out, 'second', overwrite=True)
    assert (out / 'report.json').read_text() == 'second' and [p.name for p in tmp_path.iterdir()] == ['out']
    return seen


def test_a_result_that_is_replaced_is_there_at_every_moment(tmp_path, monkeypatch):
    (tmp_path / 'a').mkdir(), (tmp_path / 'b').mkdir()
    if not results._exchange(tmp_path / 'a', tmp_path / 'b'):
        pytest.skip('this file system cannot exchange two names')
    (tmp_path / 'a').rmdir(), (tmp_path / 'b').rmdir()
    assert names_seen(tmp_path, monkeypatch) == [True]


def test_a_file_system_that_cannot_exchange_names_replaces_a_result_all_the_same(tmp_path, monkeypatch):
    monkeypatch.setattr(results, '_EXCHANGE', 1 << 20)  # what no system knows
    assert names_seen(tmp_path, monkeypatch) == [True, False, True]


@pytest.mark.parametrize('as_files', [False, True])
@pytest.mark.parametrize('heard', [False, True])
def test_an_interruption_that_a_library_loses_leaves_no_result(tmp_path, as_files, heard, capsys):
    # given a tool in which something swallows the KeyboardInterrupt of a signal
    def work():
        if as_files:
            interrupted()
            return write_files({tmp_path / 'out': 'text'})
        with result_folder(tmp_path / 'out') as folder:
            interrupted()
            (folder / 'report.json').write_text('text')

    def interrupted():
        with suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        if heard:
            heard_interruption()
    # then nothing takes the name of the result, but where who caught it says that it goes on
    assert guarded('tool', [], work) == (0 if heard else INTERRUPTED)
    assert [path.name for path in tmp_path.iterdir()] == (['out'] if heard else [])
    assert capsys.readouterr().err == ('' if heard else 'tool: interrupted, nothing was written\n')


def test_an_interruption_while_the_folder_is_made_leaves_none(tmp_path, monkeypatch, capsys):
    # given a signal that comes just when the folder for the unfinished result stands
    make = results.tempfile.mkdtemp

    def made_and_interrupted(*arguments, **options):
        path = make(*arguments, **options)
        signal.raise_signal(signal.SIGINT)
        return path
    monkeypatch.setattr(results.tempfile, 'mkdtemp', made_and_interrupted)
    # then it is removed
    assert guarded('tool', [], lambda: write(tmp_path / 'out', 'text')) == INTERRUPTED
    assert list(tmp_path.iterdir()) == []
    assert capsys.readouterr().err == 'tool: interrupted, nothing was written\n'
