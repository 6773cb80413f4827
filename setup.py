from glob import glob

from setuptools import find_packages, setup

PACKAGE = 'mems_ins_fusion'

setup(
    name=PACKAGE,
    version='0.1.0',
    description='Fusion of a low-cost inertial sensor with GNSS on land vehicles',
    license='Apache-2.0',
    packages=find_packages(include=[PACKAGE, f'{PACKAGE}.*']),
    package_data={f'{PACKAGE}.reports': ['*.css', '*.js', 'uplot/*'], f'{PACKAGE}.fleet': ['*.js']},
    python_requires='>=3.11',
    # the lowest versions are those of Ubuntu 24.04, or of the first numba for its Python: `make test-oldest`
    install_requires=['matplotlib>=3.6', 'numba>=0.59', 'numpy>=1.26', 'pyyaml>=6.0', 'rosbags>=0.11.1', 'scipy>=1.11',
                      'tqdm>=4.66'],
    extras_require={
        # ROS 2 itself, where it does not come from the system
        'ros': ['ros-jazzy-rclpy', 'ros-jazzy-common-interfaces', 'ros-jazzy-rmw-fastrtps-cpp'],
        # many recordings: clusters, Parquet, URLs; `fleet` does without, in processes of its own and with CSV
        'fleet': ['dask[distributed]>=2024.1', 'pyarrow>=14', 'fsspec>=2024.1'],
        # the documentation as a site
        'docs': ['sphinx', 'myst-parser', 'furo', 'latex2mathml'],
        # allantools, evo and statsmodels are judges: tests hold our numbers against theirs; hypothesis thinks of input;
        # DuckDB runs the queries of docs/fleet.md
        'test': ['pytest', 'pytest-xdist', 'setuptools>=70.1', 'allantools', 'evo', 'hypothesis', 'statsmodels',
                 'dask[distributed]>=2024.1', 'pyarrow>=14', 'fsspec>=2024.1', 'duckdb'],
    },
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{PACKAGE}']),
        (f'share/{PACKAGE}', ['package.xml']),
        (f'share/{PACKAGE}/config', glob('config/*.yaml')),
        (f'share/{PACKAGE}/config/sensors', glob('config/sensors/*.yaml')),
        (f'share/{PACKAGE}/config/layouts', glob('config/layouts/*')),
        (f'share/{PACKAGE}/launch', glob('launch/*.launch.py')),
        # where `ros2 run` looks; pip would put console scripts into bin only
        (f'lib/{PACKAGE}', sorted(glob('scripts/*'))),
    ],
    entry_points={'console_scripts': [f'{PACKAGE} = {PACKAGE}.__main__:main']},
    zip_safe=False,
)
