"""One function per command: what the command line, a notebook and a web page all call.

A command's function takes plain values (paths, sizes as text or numbers), does the job, writes its files whole or not
at all, and returns a frozen dataclass with ``.as_dict()``, which is what ``--json`` prints. Nothing in here prints.

====================  ==========================================================================
``quantities``        "7x6", "25mm", "5:255:2" to numbers
``photographs``       folders, globs and files to photographs; left and right to pairs
``progress``          what a command tells about its progress, and to whom
``outputs``           a folder of results, written whole or not at all
``boards``            ``detect``: the boards found in photographs, many at a time
``targets``           ``board``: a target to print
``view_selection``    which pairs belong to one rig: those that agree with one another
``rig_fitting``       one rig fitted to the pairs that agree; each record learns what became of it
``first_run``         what is compiled while photographs are searched
``calibrations``      ``calibrate``: photographs to a calibrated rig and its report
``calibration_files`` the files that ``calibrate`` writes
``rectified_pairs``   ``rectify``: rectified images and the picture that proves them
``matching``          a rectified pair of any rig matched by any method
``depth_maps``        ``disparity``: disparity, depth and point cloud of one pair
``demonstration``     ``demo``: the whole pipeline on a rendered rig of known truth
``sweeps``            ``sweep``: the paper's section 3
``crosschecks``       ``crosscheck``: a second opinion, each step by stereocal and by OpenCV
``conversions``       ``convert``: between calibration formats
``datasets``          ``fetch``: a public data set, checked against its sha256
``benchmarks``        ``bench``: kernels beside OpenCV on this machine
====================  ==========================================================================
"""
