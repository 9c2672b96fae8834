"""Objects as data, a generator per category. What ids stand for is told by `lerobot_adamanip.catalog`."""

from lerobot_adamanip.objects.base import ArticulatedObject, Joint, Link, Material, Motion, PartAnnotation, Shape

__all__ = ["ArticulatedObject", "Joint", "Link", "Material", "Motion", "PartAnnotation", "Shape"]
