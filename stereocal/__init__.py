"""stereocal: stereo camera calibration and disparity maps, every algorithm written from scratch.

The folders in alphabetical order are the pipeline and the import order::

    base → board → camera → pair → reconstruction → report → store → sweep → synthetic → verify → workflow → cli

Names import their module when first used, so ``import stereocal as sc`` costs nothing.
"""

from stereocal.base.kernel_cache import provide_kernel_cache
from stereocal.base.lazy import attach

__version__ = "0.1.0"

provide_kernel_cache()

NAMES_OF_MODULE = {
    "stereocal.base.errors": (
        "ConvergenceError",
        "DataFileError",
        "DegenerateGeometryError",
        "InputError",
        "StereocalError",
    ),
    "stereocal.base.rotations": ("rotation_matrix", "rotation_vector"),
    "stereocal.board.chessboard": ("Chessboard",),
    "stereocal.board.detection": ("Detection", "detect_chessboard", "detect_chessboard_detailed"),
    "stereocal.board.harris": ("harris_corners", "harris_response"),
    "stereocal.board.subpixel": ("refine_corners",),
    "stereocal.camera.calibration": ("CameraCalibration", "calibrate_camera"),
    "stereocal.camera.distortion": ("distort_points", "undistort_points"),
    "stereocal.camera.homography": ("fit_homography",),
    "stereocal.camera.model": ("Camera",),
    "stereocal.camera.projection": ("project_points",),
    "stereocal.camera.propagation": ("pixel_covariance", "triangulation_covariance"),
    "stereocal.camera.resampling": ("remap",),
    "stereocal.camera.undistortion": ("distortion_maps", "undistort_image", "undistortion_maps"),
    "stereocal.camera.zhang": ("zhang_intrinsics", "zhang_pose"),
    "stereocal.pair.corner_order": ("repair_corner_order",),
    "stereocal.pair.diagnosis": ("diagnose_pairs",),
    "stereocal.pair.epipolar": (
        "correct_matches",
        "epipolar_lines",
        "epipoles",
        "sampson_distance",
        "symmetric_epipolar_distance",
    ),
    "stereocal.pair.essential": ("fit_essential", "fit_essential_detailed"),
    "stereocal.pair.fundamental": ("fit_fundamental", "fit_fundamental_detailed", "fundamental_from_seven"),
    "stereocal.pair.rectification": ("Rectification", "rectify"),
    "stereocal.pair.relative_pose": ("decompose_essential", "project_to_essential", "recover_pose"),
    "stereocal.pair.rig": ("StereoRig",),
    "stereocal.pair.rig_calibration": ("RigCalibration", "calibrate_rig"),
    "stereocal.pair.stereo_calibration": ("StereoCalibration", "calibrate_stereo"),
    "stereocal.pair.uncalibrated": ("rectify_uncalibrated",),
    "stereocal.reconstruction.block_matching": ("match_bm",),
    "stereocal.reconstruction.census": ("census_transform", "match_census"),
    "stereocal.reconstruction.depth": ("disparity_to_depth", "disparity_to_points", "reprojection_matrix", "sigma_z"),
    "stereocal.reconstruction.postprocessing": ("confidence_map", "fill_holes", "weighted_median"),
    "stereocal.reconstruction.sad": ("match_sad",),
    "stereocal.reconstruction.semiglobal": ("match_sgm",),
    "stereocal.reconstruction.speckles": ("filter_speckles",),
    "stereocal.reconstruction.triangulation": ("triangulate_points", "triangulate_points_detailed"),
    "stereocal.report.quality": ("QualityReport", "evaluate_calibration"),
    "stereocal.store.calibrations": ("load_calibration", "save_calibration"),
    "stereocal.store.clouds": ("write_ply",),
    "stereocal.store.datasets": ("load_dataset",),
    "stereocal.store.images": ("read_image",),
    "stereocal.sweep.disparity_sweep": ("sweep_disparity",),
    "stereocal.synthetic.rig": ("SyntheticRig", "render_rig"),
    "stereocal.verify.bench": ("run_benchmarks",),
    "stereocal.verify.second_opinion": ("crosscheck",),
}

__getattr__, __dir__, _public = attach(__name__, NAMES_OF_MODULE)
__all__ = ["__version__", *_public]
