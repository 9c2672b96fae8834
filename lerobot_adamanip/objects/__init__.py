"""Objects as data, a generator per category. `lerobot_adamanip.catalog` tells what ids stand for.

Kind, proportions, colours and layout of an object are drawn from its number alone, so ``safe_007`` is the same
everywhere. Novel objects have kinds, combinations and proportions that no seen one has; mechanism, joints and parts are
the category's own. Hidden state is drawn per episode by the mechanism and leaves no trace in the geometry.
"""

from lerobot_adamanip.objects.base import ArticulatedObject, Joint, Link, Material, Motion, PartAnnotation, Shape

__all__ = ["ArticulatedObject", "Joint", "Link", "Material", "Motion", "PartAnnotation", "Shape"]
