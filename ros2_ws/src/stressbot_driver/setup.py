from setuptools import find_packages, setup

package_name = "stressbot_driver"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    zip_safe=True,
    maintainer="stressbot maintainers",
    maintainer_email="stressbot@example.org",
    description="Plays voltage sequences on a substrate of MicroStressBots and reports what the robots do.",
    license="Apache-2.0",
    extras_require={"instruments": ["pyvisa", "pyvisa-py"], "test": ["hypothesis", "pytest"]},
    entry_points={
        "console_scripts": [
            "driver = stressbot_driver.ros.driver_node:main",
            "instrument_emulator = stressbot_driver.ros.instrument_emulator_node:main",
            "viewer = stressbot_driver.ros.viewer_node:main",
        ],
        # A backend is an output onto a substrate; other packages add theirs under the same group.
        "stressbot_driver.backends": [
            "simulated = stressbot_driver.backends.simulated:SimulatedBackend",
            "waveform_generator = stressbot_driver.backends.waveform_generator:WaveformGeneratorBackend",
        ],
    },
)
