"""A name that programs outside of bench may still import says what replaced it, in one line."""

from importlib import import_module

import pytest

from bench.moved import MODULES, NAMES


@pytest.mark.parametrize(("old", "words"), MODULES.items())
def test_a_module_that_is_gone_names_the_one_that_replaced_it(old, words):
    with pytest.raises(ModuleNotFoundError, match=f"^{old} {words}$"):
        import_module(old)
    assert words.startswith("is now ")
    import_module(words.removeprefix("is now "))


@pytest.mark.parametrize(("old", "new"), NAMES.items())
def test_a_name_that_is_gone_names_the_one_that_replaced_it(old, new):
    module, _, name = old.rpartition(".")
    with pytest.raises(ImportError, match=f"^{old} is now {new}$"):
        exec(f"from {module} import {name}")
    home, _, name = new.rpartition(".")
    assert hasattr(import_module(home), name)


def test_a_name_that_went_to_a_part_of_its_module_is_found_there():
    for name, home in (("AssumedSpecs", "sensor_specs"), ("Runway", "flight_specs")):
        with pytest.raises(ImportError, match=f"^bench.specs.{name} is now bench.{home}.{name}$"):
            exec(f"from bench.specs import {name}")


def test_other_names_are_missed_as_always():
    with pytest.raises(AttributeError, match=r"module 'bench.data' has no attribute 'NoSuchRecord'"):
        import_module("bench.data").NoSuchRecord  # noqa: B018 - the look-up is what is tested
    with pytest.raises(ModuleNotFoundError, match=r"No module named 'bench.no_such_module'"):
        import_module("bench.no_such_module")
