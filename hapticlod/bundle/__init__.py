"""The bundle (.hlod): the one file a station needs. docs/bundle.md is the specification."""

from hapticlod.bundle.read import Bundle as Bundle
from hapticlod.bundle.read import BundleLevel as BundleLevel
from hapticlod.bundle.read import read_bundle as read_bundle
from hapticlod.bundle.structure import Section as Section
from hapticlod.bundle.write import LevelLike as LevelLike
from hapticlod.bundle.write import sign_bundle as sign_bundle
from hapticlod.bundle.write import write_bundle as write_bundle
