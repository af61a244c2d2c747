"""A virtual laser-triangulation sensor that sees through hot air.

>>> import virtual_sensor as vs
>>> scene = vs.load_scene("hot_cylinder", beta=15)  # a part, its air, a camera, a laser
>>> frame = vs.render_frame(scene)                  # radiance, and the truth at each pixel
>>> shot = vs.record(scene, frame, seed=0)          # grey values of a 12-bit camera, with the truth
>>> vs.save_png(shot, "shot.png")                   # of 12 bits, with gain, noise, saturation
>>> line = vs.line_centres(shot)                    # .row .column .sigma .width .status
>>> vs.Status.counts(line.status)                   # why columns have a centre, or none
>>> points_mm = vs.triangulate(scene, line)         # (W, 3), as if light ran straight
>>> points_mm = vs.triangulate(scene, line, medium=scene.medium)  # through the hot air

Lengths are in mm, temperatures in degC, wavelengths in nm, angles in degrees; pixels are (u, v),
integers at pixel centres. A scene may be given by its name or path: ``vs.render("hot_cylinder")``.
``help(vs.render)`` says more of each name:

Scenes, and what a camera sees of them
    load_scene           Load a scene: from its Mitsuba XML file, or by its name one that comes
                         with the program.
    new_scene            Write a scene of one's own beside a copy of its part, ready to be
                         measured.
    survey               Survey a part's file: its size, its faults, and what its facets cost.
    Scene                A loaded scene: a part in its air, the cameras that see it, the sources
                         that light it.
    render               Render a camera's image: radiance in W/(mm^2 sr), shape (H, W).
    render_frame         Render a camera's image together with its ground truth.
    render_exposure      Render a frame while the part moves past the sensor: smeared by its way,
                         skewed by rows.
    ExposedFrame         A frame that took time, and the truth at the middle of each row's
                         exposure.
    Frame                A rendered frame, and the truth at its pixels' centres.
    render_sequence      Render a camera's images while a projector shows patterns.
    PatternFrames        Frames of a sequence of K patterns.

Images as a camera gives them
    record               Record a rendered frame as the scene's camera stores it.
    RecordedFrame        What a camera stored of a frame, or of a sequence, and all that made it.
    difference           A recorded frame or image with the laser on, minus one with it off.
    DifferenceFrame      A frame with the laser on minus one with it off, above a pedestal.
    ImageSensor          A monochrome image sensor's parameters by EMVA 1288; the defaults are a
                         12-bit CMOS sensor's.
    image_sensor         A sensor by its name, or by the path of its data sheet, a TOML file.
    image_sensors        Names of the sensors that come with the program, each of a stated class.
    grey_values          Grey values that a sensor makes of light: with noise, fixed pattern,
                         black level, clipping.
    gaussian_blur        Blur an image (H, W) by a Gaussian of so many px; the light that leaves
                         it is lost.
    diffraction_blur     An image (H, W) of incoherent light behind an aperture: what speckle is in
                         the mean.
    speckled             An image (H, W) as coherent light shows it: with speckle, in the same
                         unit.
    Aperture             What the camera's lens lets through, and how coherent the light is:
                         together the speckle.
    save_png             Write a grey image as a PNG file, as a camera of so many bits gives it.
    save_tiff            Write a grey image as a TIFF file, as a camera of so many bits gives it.
    read_image           Read one grey image, or a colour of it: PNG, TIFF, JPEG, OpenEXR, others.

From images to numbers
    line_centres         Find the centres of a laser line in an image.
    lines_by_source      Find the line of each source where the scene expects its light, through
                         its air.
    LineCentres          Centres of a laser line; NaN where `status` is none of `FOUND`, nor GHOST.
    dot_centres          Find the intensity-weighted centroids of bright dots.
    triangulate          Measure the points that pixels see on a source's rays, along straight
                         or bent lines of sight.
    bent_points          Find the points that pixels see on a source's rays, and their
                         derivatives, by marched rays.
    triangulated_points  `triangulate` with a status for each pixel, and a tolerance in px.
    reconstruct          Make a range image of decoded fringes: straight, or through a medium.
    RangeImage           The points that a camera's pixels see; NaN where `status` is not OK.
    fit_cylinder         Fit a circular cylinder by orthogonal least squares.
    fit_shape            Fit a cylinder, a plane, a sphere or any shape by orthogonal least squares.
    FittedShape          The shape nearest to points; NaN in all numbers where there is none.
    compare_line         Compare the centres that are OK with the truth.
    TrueLine             A line's true rows: arrays of shape (K, W), as a column may see the
                         line up to K times.
    read_calibration     Read a sensor's calibration: a file of OpenCV or ROS (YAML, XML or
                         JSON).
    Calibration          All that `triangulate` needs of a sensor: a camera and a laser plane in
                         one world.

Fringes
    pattern_of           A pattern from its text.
    Sine                 A fringe: mean + amplitude cos(2 pi (x + 0.5)/period - phase), x being u
                         or v.
    GrayBit              A bit of the Gray code of columns or rows: of the pixel's number n, n xor
                         n/2.
    Checker              A checkerboard of square fields, the one in the upper left corner white.
    Stripe               A white stripe on black.
    Uniform              The same grey everywhere: 1 is all white, 0 all black.
    Picture              An image of the projector's size.
    Projector            A projector that shows a pattern.
    codec_of             A codec from its text.
    PhaseShift           Sinusoidal fringes in N steps, of one or several periods along one axis or
                         both.
    GrayCode             The Gray code of columns and rows, to whole projector pixels.
    SingleShot           Sinusoidal fringes of one period, decoded from one image of each axis.
    DecodedFringes       The projector's pixel at each camera pixel; NaN where `status` is not OK.
    CalibrationTarget    A plate with marks on a grid: inner corners of a checkerboard, or centres
                         of dots.
    find_marks           Find a target's marks in an image, to hundredths of a pixel.
    projector_marks      The projector's pixels at marks that a camera sees, by decoded fringes
                         around them.
    calibrate_fringes    Calibrate camera and projector by the marks of a plane in several poses.
    FringeCalibration    A camera and a projector in one world, with the covariance of what was
                         found.

Light through air
    ray_search           Find the pixels that see the incidence points of a laser's or
                         projector's rays.
    pupil_search         Find where incidence points are seen through a lens, in bent air:
                         `ray_search` for its pupil.
    PupilPixels          Where N rays' incidence points are seen from K points of the pupil.
    PupilStatus          Which part of the pupil sees what a ray of laser or projector lights.
    circle_of_confusion_px  How wide a lens out of focus shows points, by the formula of the thin
                         lens, in cold air.
    Lens                 A thin lens, its pupil and the sensor behind it.
    projector_pixels     Find the projector's pixels that light what camera pixels see, by
                         marched rays.
    epipolar_residual    How far camera pixels lie from the straight epipolar lines of their
                         projector pixels, px.
    project              The pixels at which a scene's camera sees points, along bent lines of
                         sight.
    projected_points     `project` with a status for each point.
    trace                March rays through a field for a given length of arc.
    AirModel             Fields as data, and transforms that make other air of them, with exact
                         derivatives.
    IndexField           Refractivity on a regular grid, in surroundings of uniform air.
    air_refractivity     Refractivity n - 1 of air: Ciddor's equation, continued above 100 degC.
    Pose                 Where a frame stands in the world: ``world = rotation @ local +
                         origin_mm``.

Air and shape found from images
    estimate_air         Find parameters of the air, of a shape and of the sensor's poses in what
                         images hold.
    identifiability      Tell what observations can say of parameters, without fitting any.
    fringe_observation   What decoded fringes say of air and shape, for `estimate_air`: a pixel for
                         each block.
    Observation          Pixels that one sensor measured at one moment, and what is known of their
                         light.
    Prior                What is known of a parameter before anything is measured.
    AirEstimate          Parameters of the air, of a shape and of poses as found, and how sure they
                         are.
    error_budget         Tell what an estimate, and the points through its air, may be wrong by.
    known_air_budget     Tell what points through air that is given may be wrong by.
    ErrorBudget          How far an estimate and its points may be wrong, by source.
    PointBudget          What N points may be wrong by, by source; NaN where there is no point.
    CylinderShape        A round cylinder without ends, whose axis is near the x axis of its frame.
    PlaneShape           A plane near z = 0 of its frame.
    SphereShape          A sphere.
    PartShape            A known part, such as a scene's: its form is given, where it lies may be
                         found.
    SectionShape         A known section, such as the part's when it was cold: points on a curve in
                         a plane.

Statuses, whose members have a message, and errors
    Status               Why there is a centre, or none.
    FringeStatus         Why a pixel has a projector coordinate, or none.
    MarkStatus           Whether a mark of a target takes part in a calibration, and if not, why.
    CrossingStatus       How the search for a pixel's point ended.
    SearchStatus         How the search for a ray of laser or projector ended.
    ProjectorPixelStatus Whether a projector pixel was found for a camera's, and if not, why.
    ProjectionStatus     Whether a point has a pixel, and if not, why.
    RayStatus            How a ray's march ended.
    EstimateStatus       What became of a parameter.
    InputError           A scene, a field, an option or an output folder that the program cannot
                         work with.
    EngineError          Dr.Jit or Mitsuba cannot run on this machine as things stand.

Names are loaded when first used: those that compute with Dr.Jit start the engine then. Whoever
imports drjit or mitsuba afterwards gets an LLVM library that is proven to work.
"""

import contextlib
import importlib
import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from virtual_sensor.devices.image_sensor import ImageSensor as ImageSensor
    from virtual_sensor.devices.image_sensor import image_sensor as image_sensor
    from virtual_sensor.devices.image_sensor import image_sensors as image_sensors
    from virtual_sensor.devices.patterns import Checker as Checker
    from virtual_sensor.devices.patterns import GrayBit as GrayBit
    from virtual_sensor.devices.patterns import Picture as Picture
    from virtual_sensor.devices.patterns import Sine as Sine
    from virtual_sensor.devices.patterns import Stripe as Stripe
    from virtual_sensor.devices.patterns import Uniform as Uniform
    from virtual_sensor.devices.patterns import pattern_of as pattern_of
    from virtual_sensor.devices.projector import Projector as Projector
    from virtual_sensor.errors import EngineError as EngineError
    from virtual_sensor.errors import InputError as InputError
    from virtual_sensor.imaging.difference import DifferenceFrame as DifferenceFrame
    from virtual_sensor.imaging.difference import difference as difference
    from virtual_sensor.imaging.exposures import ExposedFrame as ExposedFrame
    from virtual_sensor.imaging.exposures import render_exposure as render_exposure
    from virtual_sensor.imaging.grey_values import grey_values as grey_values
    from virtual_sensor.imaging.image_blur import gaussian_blur as gaussian_blur
    from virtual_sensor.imaging.image_files import read_image as read_image
    from virtual_sensor.imaging.image_files import save_png as save_png
    from virtual_sensor.imaging.image_files import save_tiff as save_tiff
    from virtual_sensor.imaging.new_scene.write import new_scene as new_scene
    from virtual_sensor.imaging.part_survey import survey as survey
    from virtual_sensor.imaging.recording import RecordedFrame as RecordedFrame
    from virtual_sensor.imaging.recording import record as record
    from virtual_sensor.imaging.render import Frame as Frame
    from virtual_sensor.imaging.render import render as render
    from virtual_sensor.imaging.render import render_frame as render_frame
    from virtual_sensor.imaging.scene import Scene as Scene
    from virtual_sensor.imaging.scene import load_scene as load_scene
    from virtual_sensor.imaging.sequence import PatternFrames as PatternFrames
    from virtual_sensor.imaging.sequence import render_sequence as render_sequence
    from virtual_sensor.imaging.speckle import Aperture as Aperture
    from virtual_sensor.imaging.speckle import diffraction_blur as diffraction_blur
    from virtual_sensor.imaging.speckle import speckled as speckled
    from virtual_sensor.medium.air import air_refractivity as air_refractivity
    from virtual_sensor.medium.air_model import AirModel as AirModel
    from virtual_sensor.medium.index_field import IndexField as IndexField
    from virtual_sensor.metrology.air_estimate import AirEstimate as AirEstimate
    from virtual_sensor.metrology.air_estimate import estimate_air as estimate_air
    from virtual_sensor.metrology.calibration import Calibration as Calibration
    from virtual_sensor.metrology.calibration import read_calibration as read_calibration
    from virtual_sensor.metrology.centres import LineCentres as LineCentres
    from virtual_sensor.metrology.centres import Status as Status
    from virtual_sensor.metrology.cylinder_fit import fit_cylinder as fit_cylinder
    from virtual_sensor.metrology.dot_peaks import dot_centres as dot_centres
    from virtual_sensor.metrology.error_budget import ErrorBudget as ErrorBudget
    from virtual_sensor.metrology.error_budget import PointBudget as PointBudget
    from virtual_sensor.metrology.error_budget import error_budget as error_budget
    from virtual_sensor.metrology.error_budget import known_air_budget as known_air_budget
    from virtual_sensor.metrology.fringes.calibration import FringeCalibration as FringeCalibration
    from virtual_sensor.metrology.fringes.calibration import calibrate_fringes as calibrate_fringes
    from virtual_sensor.metrology.fringes.codecs import codec_of as codec_of
    from virtual_sensor.metrology.fringes.decoded import DecodedFringes as DecodedFringes
    from virtual_sensor.metrology.fringes.decoded import FringeStatus as FringeStatus
    from virtual_sensor.metrology.fringes.gray_code import GrayCode as GrayCode
    from virtual_sensor.metrology.fringes.observations import (
        fringe_observation as fringe_observation,
    )
    from virtual_sensor.metrology.fringes.phase_shift import PhaseShift as PhaseShift
    from virtual_sensor.metrology.fringes.single_shot import SingleShot as SingleShot
    from virtual_sensor.metrology.fringes.target import CalibrationTarget as CalibrationTarget
    from virtual_sensor.metrology.fringes.target import MarkStatus as MarkStatus
    from virtual_sensor.metrology.fringes.target import find_marks as find_marks
    from virtual_sensor.metrology.fringes.target import projector_marks as projector_marks
    from virtual_sensor.metrology.identifiability import EstimateStatus as EstimateStatus
    from virtual_sensor.metrology.identifiability import identifiability as identifiability
    from virtual_sensor.metrology.line_peaks import line_centres as line_centres
    from virtual_sensor.metrology.observations import Observation as Observation
    from virtual_sensor.metrology.observations import Prior as Prior
    from virtual_sensor.metrology.range_image import RangeImage as RangeImage
    from virtual_sensor.metrology.range_image import reconstruct as reconstruct
    from virtual_sensor.metrology.shape_fits import FittedShape as FittedShape
    from virtual_sensor.metrology.shape_fits import fit_shape as fit_shape
    from virtual_sensor.metrology.shapes import CylinderShape as CylinderShape
    from virtual_sensor.metrology.shapes import PartShape as PartShape
    from virtual_sensor.metrology.shapes import PlaneShape as PlaneShape
    from virtual_sensor.metrology.shapes import SectionShape as SectionShape
    from virtual_sensor.metrology.shapes import SphereShape as SphereShape
    from virtual_sensor.metrology.triangulation import triangulate as triangulate
    from virtual_sensor.metrology.triangulation import triangulated_points as triangulated_points
    from virtual_sensor.metrology.truth import TrueLine as TrueLine
    from virtual_sensor.metrology.truth import compare_line as compare_line
    from virtual_sensor.optics.bent_points import bent_points as bent_points
    from virtual_sensor.optics.crossing_status import CrossingStatus as CrossingStatus
    from virtual_sensor.optics.epipolar import epipolar_residual as epipolar_residual
    from virtual_sensor.optics.lens import Lens as Lens
    from virtual_sensor.optics.projection import ProjectionStatus as ProjectionStatus
    from virtual_sensor.optics.projection import project as project
    from virtual_sensor.optics.projection import projected_points as projected_points
    from virtual_sensor.optics.projector_pixels import ProjectorPixelStatus as ProjectorPixelStatus
    from virtual_sensor.optics.projector_pixels import projector_pixels as projector_pixels
    from virtual_sensor.optics.pupil_search import PupilPixels as PupilPixels
    from virtual_sensor.optics.pupil_search import PupilStatus as PupilStatus
    from virtual_sensor.optics.pupil_search import circle_of_confusion_px as circle_of_confusion_px
    from virtual_sensor.optics.pupil_search import pupil_search as pupil_search
    from virtual_sensor.optics.ray_search import SearchStatus as SearchStatus
    from virtual_sensor.optics.ray_search import ray_search as ray_search
    from virtual_sensor.optics.ray_status import RayStatus as RayStatus
    from virtual_sensor.optics.trace import trace as trace
    from virtual_sensor.poses import Pose as Pose
    from virtual_sensor.studies.lines_by_source import lines_by_source as lines_by_source

_HOME = {
    "AirEstimate": "metrology.air_estimate",
    "AirModel": "medium.air_model",
    "Aperture": "imaging.speckle",
    "Calibration": "metrology.calibration",
    "CalibrationTarget": "metrology.fringes.target",
    "Checker": "devices.patterns",
    "CrossingStatus": "optics.crossing_status",
    "CylinderShape": "metrology.shapes",
    "DecodedFringes": "metrology.fringes.decoded",
    "EngineError": "errors",
    "ErrorBudget": "metrology.error_budget",
    "EstimateStatus": "metrology.identifiability",
    "FittedShape": "metrology.shape_fits",
    "DifferenceFrame": "imaging.difference",
    "ExposedFrame": "imaging.exposures",
    "Frame": "imaging.render",
    "FringeCalibration": "metrology.fringes.calibration",
    "FringeStatus": "metrology.fringes.decoded",
    "GrayBit": "devices.patterns",
    "GrayCode": "metrology.fringes.gray_code",
    "ImageSensor": "devices.image_sensor",
    "IndexField": "medium.index_field",
    "InputError": "errors",
    "Lens": "optics.lens",
    "LineCentres": "metrology.centres",
    "MarkStatus": "metrology.fringes.target",
    "Observation": "metrology.observations",
    "PatternFrames": "imaging.sequence",
    "PartShape": "metrology.shapes",
    "PhaseShift": "metrology.fringes.phase_shift",
    "Picture": "devices.patterns",
    "PlaneShape": "metrology.shapes",
    "PointBudget": "metrology.error_budget",
    "Pose": "poses",
    "Prior": "metrology.observations",
    "ProjectionStatus": "optics.projection",
    "Projector": "devices.projector",
    "ProjectorPixelStatus": "optics.projector_pixels",
    "PupilPixels": "optics.pupil_search",
    "PupilStatus": "optics.pupil_search",
    "RangeImage": "metrology.range_image",
    "RayStatus": "optics.ray_status",
    "RecordedFrame": "imaging.recording",
    "Scene": "imaging.scene",
    "SearchStatus": "optics.ray_search",
    "SectionShape": "metrology.shapes",
    "Sine": "devices.patterns",
    "SingleShot": "metrology.fringes.single_shot",
    "SphereShape": "metrology.shapes",
    "Status": "metrology.centres",
    "Stripe": "devices.patterns",
    "TrueLine": "metrology.truth",
    "Uniform": "devices.patterns",
    "air_refractivity": "medium.air",
    "bent_points": "optics.bent_points",
    "calibrate_fringes": "metrology.fringes.calibration",
    "circle_of_confusion_px": "optics.pupil_search",
    "codec_of": "metrology.fringes.codecs",
    "compare_line": "metrology.truth",
    "diffraction_blur": "imaging.speckle",
    "dot_centres": "metrology.dot_peaks",
    "epipolar_residual": "optics.epipolar",
    "error_budget": "metrology.error_budget",
    "estimate_air": "metrology.air_estimate",
    "find_marks": "metrology.fringes.target",
    "fit_cylinder": "metrology.cylinder_fit",
    "fit_shape": "metrology.shape_fits",
    "fringe_observation": "metrology.fringes.observations",
    "gaussian_blur": "imaging.image_blur",
    "grey_values": "imaging.grey_values",
    "identifiability": "metrology.identifiability",
    "image_sensor": "devices.image_sensor",
    "image_sensors": "devices.image_sensor",
    "known_air_budget": "metrology.error_budget",
    "line_centres": "metrology.line_peaks",
    "lines_by_source": "studies.lines_by_source",
    "load_scene": "imaging.scene",
    "new_scene": "imaging.new_scene.write",
    "pattern_of": "devices.patterns",
    "project": "optics.projection",
    "projected_points": "optics.projection",
    "projector_marks": "metrology.fringes.target",
    "projector_pixels": "optics.projector_pixels",
    "pupil_search": "optics.pupil_search",
    "ray_search": "optics.ray_search",
    "read_calibration": "metrology.calibration",
    "read_image": "imaging.image_files",
    "record": "imaging.recording",
    "reconstruct": "metrology.range_image",
    "render": "imaging.render",
    "difference": "imaging.difference",
    "render_exposure": "imaging.exposures",
    "render_frame": "imaging.render",
    "render_sequence": "imaging.sequence",
    "save_png": "imaging.image_files",
    "save_tiff": "imaging.image_files",
    "speckled": "imaging.speckle",
    "survey": "imaging.part_survey",
    "trace": "optics.trace",
    "triangulate": "metrology.triangulation",
    "triangulated_points": "metrology.triangulation",
}

__all__ = list(_HOME)


class _LlvmFirst:
    """Has an LLVM library chosen at the moment at which drjit is imported, by whomever.

    By default Dr.Jit takes the system's newest, of which some abort at the first kernel.
    """

    @staticmethod
    def find_spec(name: str, path: object = None, target: object = None) -> None:
        """Find nothing: the other finders import drjit."""
        if name == "drjit":
            from virtual_sensor import engine

            with contextlib.suppress(engine.EngineError):  # reported when the engine starts
                engine.choose_llvm()


if "drjit" not in sys.modules:
    sys.meta_path.insert(0, _LlvmFirst)


if not TYPE_CHECKING:  # a checker would take any name for one of ours

    def __getattr__(name: str) -> Any:
        if name not in _HOME:
            said = f"module 'virtual_sensor' has no attribute '{name}'"
            raise AttributeError(said, name=name, obj=sys.modules[__name__])  # Python has a guess
        return getattr(importlib.import_module(f"virtual_sensor.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return [] if _asked_by_help() else __all__


def _asked_by_help() -> bool:
    """Whether pydoc asks: it would load all names and print every class in full, 1,600 lines.

    What it prints is the docstring above.
    """
    frame = sys._getframe(1)
    for _ in range(4):
        frame = frame.f_back  # type: ignore[assignment]
        if frame is None:
            return False
        if frame.f_globals.get("__name__") == "pydoc":
            return True
    return False
