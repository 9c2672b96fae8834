"""Generator of microwaves."""

from lerobot_adamanip.objects.microwave.generator import make_microwave
from lerobot_adamanip.objects.microwave.novel import make_novel_microwave

__all__ = ["make_microwave", "make_novel_microwave"]
