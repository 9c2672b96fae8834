"""What `lerobot-train --policy.push_to_hub=true` publishes of our policies: our card, and nothing of the machine."""

from __future__ import annotations

import copy
from typing import Any

from lerobot.policies.pretrained import PreTrainedPolicy

from lerobot_adamanip.util.errors import ConfigurationError


class PublishesOurCard:
    """Mixed into a policy: its card is ours, and what LeRobot uploads beside it names no folder.

    LeRobot's own card is checked at the public Hub's address whatever ``HF_ENDPOINT`` says, and its copy of the
    training's configuration holds the trainer's paths.
    """

    config: Any

    def require_own_push(self) -> None:
        """Check, before a training, that `--policy.push_to_hub=true` can publish our card and no local path.

        LeRobot 0.6.1 asks the policy for its card and hands it the training's configuration. Later versions publish
        both from a function of their own, `publish_trained_model`, which offers no hook.

        Raises:
            ConfigurationError: the policy is to be published and this LeRobot offers no hook.
        """
        asked = self.config.push_to_hub and self.config.repo_id
        if asked and not hasattr(PreTrainedPolicy, "generate_model_card"):
            raise ConfigurationError(
                "This LeRobot publishes a policy with the local paths of its training.",
                got=f"--policy.push_to_hub=true, to {self.config.repo_id}",
                allowed="--policy.push_to_hub=false",
                hint="train with --policy.push_to_hub=false, then adamanip push model CHECKPOINT --repo-id USER/NAME",
            )

    def push_to_hub(self, *args: Any, **kwargs: Any) -> Any:
        """LeRobot's own upload of weights and configuration, checked as in `require_own_push`."""
        self.require_own_push()
        return super().push_to_hub(*args, **kwargs)  # type: ignore[misc]

    def generate_model_card(self, *args: Any, cfg: Any = None, dataset_meta: Any = None, **kwargs: Any) -> Any:
        """The card that `adamanip push model` makes; nobody is asked whether its header is lawful before the upload."""
        import draccus
        from huggingface_hub import ModelCard

        from lerobot_adamanip.datasets.cards.templates import check_card
        from lerobot_adamanip.hub.model_card import Checkpoint, model_card
        from lerobot_adamanip.hub.portable_config import shareable

        config = {**draccus.encode(self.config), "type": self.config.type}
        network, updates = getattr(self, "model", None), getattr(self, "ema_steps", None)
        checkpoint = Checkpoint(
            shareable(config),
            {} if cfg is None else shareable(draccus.encode(cfg)),
            0 if network is None else sum(each.numel() for each in network.parameters()),
            None if updates is None else int(updates),
        )
        text = model_card(checkpoint, self.config.repo_id or "USER/NAME")
        check_card(text, "model")
        return ModelCard(text)

    def push_model_to_hub(self, cfg: Any, *args: Any, **kwargs: Any) -> None:
        """LeRobot's own upload, of configurations that name no folder of this machine."""
        from lerobot_adamanip.hub.portable_config import is_local, shareable_copy

        kept = self.config
        if is_local(kept.pretrained_path):
            self.config = copy.deepcopy(kept)
            self.config.pretrained_path = None
        try:
            super().push_model_to_hub(shareable_copy(cfg), *args, **kwargs)  # type: ignore[misc]
        finally:
            self.config = kept
