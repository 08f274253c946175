"""Simulated scanners: scans of made-up scenes whose true surface is known.

scenes/             rooms, streets, terrain, machine parts and statues, made by code
scene.py            a triangle mesh with named parts        surface.py   rays and nearest points on it
solids.py           boxes, tubes and other pieces           fields.py    smooth random fields
beam.py             what a laser beam measures              poses.py     rotations and registration errors
terrestrial.py, lines.py, depth_camera.py, structured_light.py, photogrammetry.py      the sensors
scan.py             the result, and its file                catalog.py   every kind of scan by name and seed

Training and benchmark take their scans from here. Needs the extra ``scanners``.
"""
