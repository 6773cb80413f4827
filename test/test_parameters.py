"""Every check of the parameters, and their YAML with ROS's ways of reading it."""
from __future__ import annotations

import math
from pathlib import Path

import pytest
import yaml

from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.parameters import __main__ as documents
from mems_ins_fusion.parameters.parameter import ParameterError
from mems_ins_fusion.parameters.params_file import load_yaml
from mems_ins_fusion.parameters.table import ALL, FILTER, FUSION, REPLAY, check, defaults


def written(tmp_path, text):
    path = tmp_path / 'params.yaml'
    path.write_text(text)
    return path


@pytest.mark.parametrize('name', ALL)
def test_each_default_passes_its_own_check(name):
    parameter = ALL[name]
    value = parameter.check(parameter.default)
    assert value == parameter.default and type(value) is type(parameter.default)
    assert parameter.description.rstrip().endswith('.') and parameter.unit


def test_names_are_unique():
    tables = [*FILTER, *FUSION, *REPLAY]
    assert len({p.name for p in tables}) == len(tables) == len(ALL)


def test_defaults_are_new_each_time():
    defaults()['gnss.lever_arm'].append(1.0)
    assert defaults()['gnss.lever_arm'] == [0.0, 0.0, 0.0]


def test_check_lays_values_over_the_defaults():
    values = check({'gnss.sigma': 2.0})
    assert values['gnss.sigma'] == 2.0 and values['gnss.default_sigma'] == 3.0
    assert set(values) == set(ALL)


@pytest.mark.parametrize(('given', 'expected'), [
    (2, 2.0), ('1e-3', 1e-3), ('2', 2.0), (1e-3, 1e-3), ('.5', 0.5)])
def test_what_ros_reads_as_a_double_is_one(given, expected):
    value = check({'gnss.sigma': given})['gnss.sigma']
    assert value == expected and type(value) is float


@pytest.mark.parametrize(('given', 'expected'), [(3, 3), (3.0, 3), ('3', 3)])
def test_whole_numbers(given, expected):
    value = check({'seed': given})['seed']
    assert value == expected and type(value) is int


@pytest.mark.parametrize(('given', 'expected'), [
    ([1, 2.5, '1e-3'], [1.0, 2.5, 1e-3]), ((1, 2, 3), [1.0, 2.0, 3.0])])
def test_mixed_lists_are_lists_of_floats(given, expected):
    value = check({'gnss.lever_arm': given})['gnss.lever_arm']
    assert value == expected and all(type(v) is float for v in value)


def test_one_value_for_a_list_is_a_list_of_one():
    assert check({'gyroscope.bias': 1e-3})['gyroscope.bias'] == [1e-3]
    assert check({'models': 'random_walk'})['models'] == ['random_walk']
    assert check({'bag': '/data/drive'})['bag'] == ['/data/drive']
    assert check({'bag': None})['bag'] == []  # how ROS hands over []


@pytest.mark.parametrize(('name', 'value', 'message'), [
    ('gnss.sigma', math.nan, "parameter 'gnss.sigma' must be a number, got nan"),
    ('gnss.sigma', '.nan', "parameter 'gnss.sigma' must be a number, got '.nan'"),
    ('gnss.sigma', math.inf, "parameter 'gnss.sigma' must be a number, got inf"),
    ('gnss.sigma', 'two', "parameter 'gnss.sigma' must be a number, got 'two'"),
    ('gnss.sigma', True, "parameter 'gnss.sigma' must be a number, got True"),
    ('gnss.sigma', None, "parameter 'gnss.sigma' must be a number, got None"),
    ('gnss.sigma', [1.0], "parameter 'gnss.sigma' must be a number, got [1.0]"),
    ('gnss.sigma', -1, "parameter 'gnss.sigma' must be at least 0 and at most 1000 m, got -1"),
    ('gnss.sigma', 1001, "parameter 'gnss.sigma' must be at least 0 and at most 1000 m, got 1001"),
    ('gnss.default_sigma', 0, "parameter 'gnss.default_sigma' must be above 0 and at most 1000 m, got 0"),
    ('gnss.time_offset', 61, "parameter 'gnss.time_offset' must be at least -60 and at most 60 s, got 61"),
    ('imu.max_gap', 0.0, "parameter 'imu.max_gap' must be above 0 and at most 60 s, got 0"),
    ('seed', 1.5, "parameter 'seed' must be a whole number, got 1.5"),
    ('seed', -1, "parameter 'seed' must be at least 0 and at most 9.0072e+15, got -1"),
    ('publish_tf', 'yes', "parameter 'publish_tf' must be true or false, got 'yes'"),
    ('publish_tf', 1, "parameter 'publish_tf' must be true or false, got 1"),
    ('imu_topic', 5, "parameter 'imu_topic' must be a text, got 5"),
    ('mechanization', '3d', "parameter 'mechanization' must be one of planar, strapdown; got '3d'"),
    ('models', ['random_walk', 'rw'],
     "parameter 'models' must be one of random_walk, gauss_markov, autoregressive; got 'rw'"),
    ('gnss.lever_arm', [1.0, 2.0], "parameter 'gnss.lever_arm' must have 3 values, got 2: [1.0, 2.0]"),
    ('gnss.lever_arm', [1.0, 2.0, math.nan], "parameter 'gnss.lever_arm' must be a number, got nan"),
    ('gyroscope.bias', [1.0, 2.0], "parameter 'gyroscope.bias' must have 1 or 3 values, got 2: [1.0, 2.0]"),
    ('gyroscope.bias', [], "parameter 'gyroscope.bias' must have 1 or 3 values, got 0: []"),
    ('gyroscope.scale', [0.6], "parameter 'gyroscope.scale' must be at least -0.5 and at most 0.5, got 0.6"),
    ('datum', [48.0, 11.0], "parameter 'datum' must have 0 or 3 values, got 2: [48.0, 11.0]")])
def test_values_that_do_not_fit_are_refused_in_one_line(name, value, message):
    with pytest.raises(ParameterError) as error:
        check({name: value})
    assert str(error.value) == message


def test_unknown_names_are_refused_with_a_hint():
    with pytest.raises(ParameterError, match=r"unknown parameter 'gnss.levr_arm'; did you mean 'gnss.lever_arm'\?"):
        check({'gnss.levr_arm': [0, 0, 0]})
    with pytest.raises(ParameterError, match="^unknown parameter 'zzz'$"):
        check({'zzz': 1})


def test_a_parameter_error_is_a_value_error():
    assert issubclass(ParameterError, ValueError)


# --- YAML ---

def test_sections_are_flattened_and_those_of_nodes_come_last(tmp_path):
    path = written(tmp_path, '''
/**:
  ros__parameters:
    gnss: {sigma: 1.0, lever_arm: [1, 2, 3]}
    gnss.default_sigma: 4.0
    mechanization: strapdown
fusion_node:
  ros__parameters:
    gnss:
      sigma: 1e-3
''')
    assert load_yaml(path) == {'gnss.sigma': '1e-3', 'gnss.lever_arm': [1, 2, 3], 'gnss.default_sigma': 4.0,
                               'mechanization': 'strapdown'}
    assert check(load_yaml(path))['gnss.sigma'] == 1e-3


@pytest.mark.parametrize(('text', 'message'), [
    ('/**:\n  gnss.sigma: 2.0\n', "each node's parameters must stand under 'ros__parameters'"),
    ('/**:\n  ros__parameters: 5\n', "each node's parameters must stand under 'ros__parameters'"),
    ('/**: 3\n', "each node's parameters must stand under 'ros__parameters'"),
    ('', 'holds no parameters'),
    ('{}', 'holds no parameters'),
    ('- 1\n- 2\n', 'holds no parameters'),
    ('/**:\n  ros__parameters:\n   a: [1, 2\n', 'is not valid YAML'),
    ('/**:\n\tros__parameters:\n', 'is not valid YAML')])
def test_files_that_cannot_be_used_are_refused_in_one_line(tmp_path, text, message):
    path = written(tmp_path, text)
    with pytest.raises(ParameterError, match=message) as error:
        load_yaml(path)
    assert str(path) in str(error.value) and '\n' not in str(error.value)


def test_missing_and_binary_files_are_refused(tmp_path):
    with pytest.raises(ParameterError, match='No such file'):
        load_yaml(tmp_path / 'none.yaml')
    path = tmp_path / 'binary.yaml'
    path.write_bytes(b'\xff\xfe\x00\x01\x80')
    with pytest.raises(ParameterError, match='not valid YAML'):
        load_yaml(path)


def test_the_example_is_the_defaults_in_the_types_of_ros(tmp_path):
    path = written(tmp_path, documents.example())
    values = load_yaml(path)
    assert set(values) == {p.name for p in (*FILTER, *FUSION)}
    assert check(values) == defaults()
    for name, value in values.items():  # a double without a point would be an integer to ROS
        default = ALL[name].default
        assert type(value) is type(default)
        if isinstance(default, list):
            assert [type(v) for v in value] == [type(v) for v in default]


def test_documents_are_written_from_the_table():
    root = Path(__file__).resolve().parents[1]
    assert (root / 'docs' / 'parameters.md').read_text() == documents.markdown()
    assert (root / 'config' / 'fusion.yaml').read_text() == documents.example()
    table = documents.markdown()
    for name in ALL:
        assert f'| `{name}` |' in table
    assert yaml.safe_load(documents.example())


# --- parameters that do not fit together ---

def test_a_filter_takes_axes_through_the_mounting():
    # given per-axis sensor values and sensor axes x left, y back, z up: b forward is -s y
    config = FilterConfig.from_parameters(check({
        'imu.mounting_rpy': [0, 0, math.pi / 2], 'sensor_error_model': 'random_walk',
        'accelerometer.random_walk.q': [1.0, 2.0, 3.0], 'accelerometer.noise_density': [0.1, 0.2, 0.3],
        'accelerometer.bias': [0.01, 0.02, 0.03], 'accelerometer.scale': [0.0, 0.25, 0.0]}))
    assert [model.q for model in config.models][:2] == [2.0, 1.0]
    assert config.white[:3] == pytest.approx([0.04, 0.01, 0.09])
    measured = [0.01, 0.02 + 1.25 * 4.0, 0.03, 0, 0, 0]  # 4 m/s^2 along sensor y
    assert config.conditioning @ measured + config.offset == pytest.approx([-4.0, 0, 0, 0, 0, 0], abs=1e-15)


def test_models_of_different_order_are_filled_up():
    config = FilterConfig.from_parameters(check({
        'sensor_error_model': 'autoregressive', 'gyroscope.autoregressive.coefficients': [-0.9]}))
    assert config.layout.order == 2 and config.layout.n_sensor == 2 * 6
    assert [model.coefficients for model in config.models[3:]] == 3 * [(-0.9, 0.0)]


@pytest.mark.parametrize('name', ['accelerometer', 'gyroscope'])
def test_an_unstable_model_is_refused_by_name(name):
    with pytest.raises(ParameterError, match=f"'{name}.autoregressive.coefficients'.*not stable"):
        FilterConfig.from_parameters(check({'sensor_error_model': 'autoregressive',
                                            f'{name}.autoregressive.coefficients': [-2.0, 0.5]}))
