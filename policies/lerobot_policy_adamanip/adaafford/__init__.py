"""The policy ``adaafford``: AdaAfford (Wang et al., ECCV 2022) on key frames, the adaptive row of AdaManip's table.

A vector z summarises past interactions and predicts the next one's success. The first few are also chosen for their
information. One interaction is one motion in contact. Sources: released code (`wangyian-me/AdaAffordCode`) for modules
and losses; AdaManip, section 5, for the row.

==============================================  ======================================================================
published                                       here
==============================================  ======================================================================
z, a mean of interactions weighted by attention `network.AdaAffordNetwork.summary`
AAP, success given z: ``BCE(C, success)``       `AdaAffordPolicy._success_error`
AIP, information: ``L1(G, CE without - CE       `AdaAffordPolicy._information_error`
with)``
maps: best 3 of C; best 5 of G and of C         `AdaAffordPolicy._map_error`
actor (Where2Act's proposals)                   `affordance.ConditionalVAE`, `AdaAffordPolicy._actor_error`
test: explore up to 4 times, then exploit       `AdaAffordPolicy._plan`
==============================================  ======================================================================

Deviations
----------
- **Data**: adaptive demonstrations are sequences of interactions under one hidden state. AIP chooses none in training.
- **Result of an interaction**: the pose commanded, the part left undone, and the gripper (`events`), instead of the
  part's motion from the simulator. **Success** is "nearer to open", not "it moved": a try that did not fail, and not
  its way back. Otherwise the policy could turn back and forth forever.
- **Known results**: those of the row's stretch, in which nothing moved (`interactions`), instead of 32 random ones. One
  z summarises all earlier interactions, another one all but the latest, with their order and the present cloud.
- **Negatives**: the targets of success and information are zero away from demonstrated contacts.
- **A held part** is kept unless another contact promises 0.1 more, since a new grasp costs key frames. Candidates
  include the last motion again and the way back.
- **The actor**: a conditional VAE that learns from tries, without z, with two nats of free bits (Kingma et al. 2016).
- **Networks**: PointNets on 256 points and on the 32 around a place instead of a PointNet++ on 10,000; all trained at
  once; AdamW with a cosine; the success map by cross-entropy, since L1 drives it to zero.
"""
