"""What ament_python asks for beside setup.cfg: the marker of the package, and its package.xml."""

from setuptools import setup

setup(
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/mbocp_ros"]),
        ("share/mbocp_ros", ["package.xml"]),
    ],
    zip_safe=True,
)
