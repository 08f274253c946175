"""``pcdnf benchmark``: clean clouds x noise x methods, as figures, tables and pictures.

clouds.py     clean clouds from files or made by code      noise.py      what is added to them
methods.py    the noisy input, our models                  peers.py      CGAL and Open3D, the extra ``peers``
runs.py       the runs themselves, resumable               intervals.py  is a difference more than chance?
tables.py     CSV and Markdown                             pictures.py   errors in colour, curves
published.py  figures measured elsewhere                   report.py     everything that is written about the runs
choice.py     a peer with its best parameter               filters.py    CGAL, PCL, MeshLab, CloudCompare to choose from
scans.py      scans with their truth, and scores           scan_runs.py, scan_report.py      runs and tables of them
"""
