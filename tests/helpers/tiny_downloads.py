"""Tiny stand-ins, with random weights, for what LeRobot's language policies download."""

from __future__ import annotations

from pathlib import Path

from lerobot.configs import FeatureType, PolicyFeature
from lerobot.policies.factory import make_pre_post_processors
from lerobot.policies.smolvla.configuration_smolvla import SmolVLAConfig
from lerobot.policies.smolvla.modeling_smolvla import SmolVLAPolicy
from tokenizers import Tokenizer, decoders, models, pre_tokenizers, trainers
from transformers import (
    CLIPConfig,
    CLIPModel,
    PreTrainedTokenizerFast,
    SmolVLMConfig,
    SmolVLMImageProcessor,
    SmolVLMProcessor,
    SmolVLMVideoProcessor,
)

from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.contract.memory import SO_FAR

PADDING, END, PICTURE = "<pad>", "<end>", "<image>"
MARKS = {"image_token": PICTURE, "fake_image_token": "<around>", "global_image_token": "<global>"}
SPECIAL = (PADDING, END, *MARKS.values())
SENTENCE = f"{SO_FAR}turned left twice: blocked; turned right: moved; pulled 3 times: blocked; pushed: moved."
SMALL = {"intermediate_size": 32, "num_hidden_layers": 2, "num_attention_heads": 2}
IMAGE = {"image_size": 32, "patch_size": 16}


def tokenizer() -> PreTrainedTokenizerFast:
    """A tokenizer of bytes, and of the words of our instructions and memories."""
    core = Tokenizer(models.BPE())
    core.pre_tokenizer = pre_tokenizers.ByteLevel(add_prefix_space=False)
    core.decoder = decoders.ByteLevel()
    alphabet = pre_tokenizers.ByteLevel.alphabet()
    trainer = trainers.BpeTrainer(vocab_size=1000, special_tokens=list(SPECIAL), initial_alphabet=alphabet)
    core.train_from_iterator([f"{category.instruction}{SENTENCE}" for category in CATEGORIES.values()], trainer)
    marks = {**MARKS, "end_of_utterance_token": END}
    return PreTrainedTokenizerFast(tokenizer_object=core, pad_token=PADDING, eos_token=END, extra_special_tokens=marks)


def write_clip(folder: Path) -> None:
    """The stand-in for ``openai/clip-vit-base-patch16``."""
    words = tokenizer()
    text = {**SMALL, "hidden_size": 16, "vocab_size": len(words), "eos_token_id": SPECIAL.index(END)}
    config = CLIPConfig(text_config=text, vision_config={**SMALL, **IMAGE, "hidden_size": 16}, projection_dim=16)
    CLIPModel(config).save_pretrained(folder)
    words.save_pretrained(folder)


def write_smolvla(folder: Path) -> None:
    """The stand-in for ``lerobot/smolvla_base``: three cameras, and six numbers of state and action."""
    words, backbone = tokenizer(), folder / "smolvlm"
    text = {**SMALL, "model_type": "llama", "hidden_size": 32, "head_dim": 16, "num_key_value_heads": 2}
    config = SmolVLMConfig(
        text_config={**text, "vocab_size": len(words), "pad_token_id": SPECIAL.index(PADDING)},
        vision_config={**SMALL, **IMAGE, "hidden_size": 16},
        scale_factor=1,
        image_token_id=SPECIAL.index(PICTURE),
        pad_token_id=SPECIAL.index(PADDING),
    )
    config.save_pretrained(backbone)
    SmolVLMProcessor(SmolVLMImageProcessor(), words, SmolVLMVideoProcessor()).save_pretrained(backbone)
    image, six = PolicyFeature(FeatureType.VISUAL, (3, 256, 256)), (6,)
    policy = SmolVLAConfig(
        input_features={
            "observation.state": PolicyFeature(FeatureType.STATE, six),
            **{f"observation.images.camera{number}": image for number in (1, 2, 3)},
        },
        output_features={"action": PolicyFeature(FeatureType.ACTION, six)},
        vlm_model_name=str(backbone),
        num_vlm_layers=2,
        resize_imgs_with_padding=(32, 32),
        device="cpu",
        push_to_hub=False,
    )
    SmolVLAPolicy(policy).save_pretrained(folder)
    for pipeline in make_pre_post_processors(policy):
        pipeline.save_pretrained(folder)
