"""Hand motions: recorded, or made on a scan's surface."""

from hapticlod.motion.laying import lay_on_scan as lay_on_scan
from hapticlod.motion.laying import near_share as near_share
from hapticlod.motion.motion import Motion as Motion
from hapticlod.motion.motion import save_motion as save_motion
from hapticlod.motion.recording import load_motion as load_motion
from hapticlod.motion.strokes import MODES as MODES
from hapticlod.motion.synthesise import synthesise as synthesise
