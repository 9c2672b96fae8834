"""What a policy says of data that it cannot use."""

from __future__ import annotations

import pytest
from lerobot.configs.types import FeatureType, PolicyFeature

from lerobot_adamanip.contract import schema
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_policy_adamanip import DP3AdaptiveConfig


@pytest.mark.parametrize(("trained", "said"), [(None, "--policy.num_points=512"), ("p", "--env.num_points=1024")])
def test_clouds_of_too_few_points_name_the_option_that_helps(trained: str | None, said: str) -> None:
    """A policy that is to be trained can use fewer; a trained one cannot."""
    config = DP3AdaptiveConfig(
        num_points=1024,
        device="cpu",
        input_features={
            schema.POINT_CLOUD: PolicyFeature(FeatureType.ENV, (512, 3)),
            schema.STATE: PolicyFeature(FeatureType.STATE, (schema.STATE_DIM,)),
        },
        output_features={schema.ACTION: PolicyFeature(FeatureType.ACTION, (schema.ACTION_DIM,))},
    )
    config.pretrained_path = trained
    with pytest.raises(ConfigurationError, match="Wrong number of points") as error:
        config.validate_features()
    assert said in str(error.value).rpartition("try:")[2]
