"""Start fusion_node: `ros2 launch mems_ins_fusion fusion.launch.py params_file:=my_vehicle.yaml`.

preset:=FILE names a params file that lies below it, as those of config/sensors.
"""
from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare


def check_params_files(context):
    """Refuse a file that is not there: launch would start the node with its defaults."""
    for name in ('preset', 'params_file'):
        path = LaunchConfiguration(name).perform(context)
        if not Path(path).is_file():
            raise RuntimeError(f"{name} '{path}' does not exist")


def generate_launch_description():
    defaults = PathJoinSubstitution([FindPackageShare('mems_ins_fusion'), 'config', 'fusion.yaml'])
    return LaunchDescription([
        DeclareLaunchArgument('preset', default_value=defaults, description='parameters of a sensor; what params_file '
                              'says counts more'),
        DeclareLaunchArgument('params_file', default_value=LaunchConfiguration('preset'),
                              description='parameters of the vehicle'),
        DeclareLaunchArgument('namespace', default_value='', description='namespace of the node and of the topics '
                              'whose names in the parameters do not start with a slash'),
        DeclareLaunchArgument('use_sim_time', default_value='false', description='take the time from /clock'),
        OpaqueFunction(function=check_params_files),
        Node(
            package='mems_ins_fusion',
            executable='fusion_node',
            namespace=LaunchConfiguration('namespace'),
            output='screen',
            parameters=[
                LaunchConfiguration('preset'),
                LaunchConfiguration('params_file'),
                {'use_sim_time': ParameterValue(LaunchConfiguration('use_sim_time'), value_type=bool)},
            ],
        ),
    ])
