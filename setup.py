# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Package description, read by colcon (ament_python) and pip alike."""

from pathlib import Path
import sys

from setuptools import find_packages, setup

PACKAGE = 'tdm_planner'
# Under `colcon build --symlink-install` this file is reached through a link.
HERE = Path(__file__).resolve().parent
# The environment of `make setup`. Executables that colcon installs run in it, whoever builds them.
ENVIRONMENT = HERE / '.venv' / 'bin' / 'python'
if ENVIRONMENT.is_file():
    sys.executable = str(ENVIRONMENT)


def shared(folder: str) -> list[tuple[str, list[str]]]:
    """Every file under `folder`, to be installed under share/ with its sub-folders kept."""
    files = [path.relative_to(HERE) for path in sorted((HERE / folder).rglob('*.*'))]
    parents = sorted({path.parent for path in files if '__pycache__' not in path.parts})
    return [
        (f'share/{PACKAGE}/{parent}', [str(path) for path in files if path.parent == parent])
        for parent in parents
    ]


setup(
    name=PACKAGE,
    version='0.2.0',
    description='Near-optimal trajectories in real time by the direct method, for ROS 2',
    long_description=(HERE / 'README.md').read_text(encoding='utf-8'),
    long_description_content_type='text/markdown',
    url='https://example.org/tdm_planner',
    author='The tdm_planner authors',
    author_email='tdm_planner@example.org',
    maintainer='The tdm_planner authors',
    maintainer_email='tdm_planner@example.org',
    license='Apache-2.0',
    python_requires='>=3.10',
    packages=find_packages(include=['tdm_planner', 'tdm_planner.*', 'tdm_sim', 'tdm_sim.*']),
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{PACKAGE}']),
        (f'share/{PACKAGE}', ['package.xml']),
        *shared('config'),
        *shared('launch'),
    ],
    package_data={'tdm_sim.report': ['assets/*']},
    zip_safe=False,
    # The oldest versions are those of Ubuntu 24.04; what its archive lacks comes by pip.
    install_requires=[
        'casadi',
        'daqp',
        'matplotlib>=3.6.3',
        'mcap',
        'numba',
        'numpy>=1.26.4',
        'plotly>=5.15',
        'PyYAML>=6.0.1',
        'rich>=13.7',
        'rosbags',
        'scipy>=1.11.4',
        'zstandard',
    ],
    extras_require={
        # ROS 2 Jazzy as wheels, for machines without ROS. Never a requirement: a sourced ROS 2
        # must not be shadowed.
        'jazzy': ['ros-jazzy-rclpy[fastrtps]==7.1.6', 'ros-jazzy-common-interfaces==5.3.6'],
        # `tdm study`; pyarrow 26 needs NumPy 2, and Ubuntu 24.04 has 1.26.
        'study': ['dask', 'distributed', 'pyarrow<26'],
        'test': [
            'catkin-pkg',
            'colcon-core',
            'colcon-ros',
            'cyclonedds; python_version < "3.14"',
            'hypothesis',
            'mcap-ros2-support',
            'mujoco',
            'pytest',
            'pytest-xdist',
            'selenium',
            'setuptools<80',
            'urdf-parser-py',
        ],
        'dev': [
            'flake8',
            'flake8-blind-except',
            'flake8-builtins',
            'flake8-class-newline',
            'flake8-comprehensions',
            'flake8-deprecated',
            'flake8-docstrings',
            'flake8-import-order',
            'flake8-quotes',
            'mypy',
            'ruff',
            'scipy-stubs',
            'types-PyYAML',
        ],
        # The page of `tdm live`.
        'live': ['trimesh', 'viser'],
        'docs': ['furo', 'myst-parser', 'sphinx'],
    },
    entry_points={
        'console_scripts': [
            'planner = tdm_planner.nodes.planner:main',
            'tracker = tdm_planner.nodes.tracker:main',
            'pendulum_plant = tdm_sim.pendulum_plant:main',
            'plant = tdm_sim.stated_plant:main',
            'robot_plant = tdm_sim.robot_plant:main',
            'tdm = tdm_planner.cli:main',
        ],
        'tdm_planner.problems': [
            'pendulum_swing_up = tdm_planner.problems.pendulum.problem:PendulumSwingUp',
            'robot_formation = tdm_planner.problems.formation.problem:RobotFormation',
        ],
    },
    classifiers=[
        'Development Status :: 4 - Beta',
        'Intended Audience :: Science/Research',
        'Operating System :: POSIX :: Linux',
        'Programming Language :: Python :: 3',
        'Topic :: Scientific/Engineering',
    ],
)
