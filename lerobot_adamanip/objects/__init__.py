"""Objects as data, with one generator per category. `lerobot_adamanip.catalog` maps ids to objects.

The number of an object alone determines its kind, proportions, colours and layout, so ``safe_007`` is equal everywhere.
Novel objects have kinds, combinations and proportions outside those of seen ones, but the category's mechanism, joints
and parts. The mechanism samples the hidden state per episode; it does not show in the geometry.
"""

from lerobot_adamanip.objects.base import ArticulatedObject, Joint, Link, Material, Motion, PartAnnotation, Shape

__all__ = ["ArticulatedObject", "Joint", "Link", "Material", "Motion", "PartAnnotation", "Shape"]
