"""The layouts of config/layouts: formats as the programs read them, topics and fields that the node has."""
from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import yaml
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import NavSatFix

from mems_ins_fusion.parameters.table import defaults

FOLDER = Path(__file__).resolve().parents[1] / 'config' / 'layouts'
REFUSED = {'/fusion_node/refused_fixes': NavSatFix, '/fusion_node/refused_points': PointStamped}
TOPICS = {defaults()['odometry_topic']: Odometry, defaults()['fix_topic']: NavSatFix, '/diagnostics': DiagnosticArray,
          **REFUSED}


def resolved(path, separator):
    """The value of a field that a plot names, in an empty message."""
    topic = max((t for t in TOPICS if path.startswith(t + separator)), key=len)
    value = TOPICS[topic]()
    for name, index in re.findall(r'(\w+)(?:\[(\d+)\])?', path[len(topic):]):
        value = getattr(value, name)
        value = value[int(index)] if index else value
    return value


def test_plotjuggler_draws_fields_that_there_are():
    root = ElementTree.parse(FOLDER / 'plotjuggler.xml').getroot()
    assert root.tag == 'root' and root.find('tabbed_widget').get('parent') == 'main_window'
    for splitter in root.iter('DockSplitter'):
        assert int(splitter.get('count')) == len(splitter) == len(splitter.get('sizes').split(';'))
    curves = list(root.iter('curve'))
    for curve in curves:
        names = [curve.get('curve_x'), curve.get('curve_y')] if curve.get('curve_x') else [curve.get('name')]
        assert all(isinstance(resolved(name, '/'), float) for name in names)
    assert len(curves) > 4
    assert any('/fusion_node/refused_points' in curve.get('name') for curve in curves)


def panels(layout):
    """The panels that a layout of Foxglove shows: a tree of splits with names as leaves."""
    if isinstance(layout, str):
        return [layout]
    assert layout['direction'] in ('row', 'column')
    return panels(layout['first']) + panels(layout['second'])


def test_foxglove_shows_each_panel_and_fields_that_there_are():
    content = json.loads((FOLDER / 'foxglove.json').read_text())
    assert sorted(panels(content['layout'])) == sorted(content['configById'])
    for name, config in content['configById'].items():
        assert re.fullmatch(r'\w+!\w+', name)
        assert all(isinstance(resolved(path['value'], '.'), float) for path in config.get('paths', ()))
        named = {config.get('followTopic'), config.get('topicToRender'), *config.get('topics', {})} - {None}
        assert named <= TOPICS.keys()
    shown = {topic for config in content['configById'].values() for topic in config.get('topics', {})}
    assert shown >= REFUSED.keys()


def test_rviz_shows_the_odometry_in_its_frame_and_sends_the_start_pose():
    content = yaml.safe_load((FOLDER / 'fusion.rviz').read_text())['Visualization Manager']
    shown = {display['Class']: display for display in content['Displays']}
    assert shown['rviz_default_plugins/Odometry']['Topic']['Value'] == defaults()['odometry_topic']
    assert shown['rviz_default_plugins/PointStamped']['Topic']['Value'] == '/fusion_node/refused_points'
    assert content['Global Options']['Fixed Frame'] == defaults()['frame_id']
    assert content['Views']['Current']['Target Frame'] == defaults()['child_frame_id']
    tools = {tool['Class']: tool for tool in content['Tools']}
    assert tools['rviz_default_plugins/SetInitialPose']['Topic']['Value'] == defaults()['initial_pose_topic']
