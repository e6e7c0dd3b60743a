from splatproof import metrics as metrics
from splatproof.api.fitting import Fitted as Fitted
from splatproof.api.fitting import fit as fit
from splatproof.api.models import load as load
from splatproof.api.models import rasterize as rasterize
from splatproof.api.plugins import use_plugin as use_plugin
from splatproof.api.results import results_frame as results_frame
from splatproof.api.scenes import open_scene as open_scene
from splatproof.base.errors import DataError as DataError
from splatproof.base.errors import MissingError as MissingError
from splatproof.base.errors import SplatproofError as SplatproofError
from splatproof.base.errors import UsageError as UsageError
from splatproof.reference.types.camera import Camera as Camera
from splatproof.reference.types.scene import camera_view as camera_view

__version__: str
