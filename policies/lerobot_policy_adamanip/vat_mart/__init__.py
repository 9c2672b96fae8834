"""The policy ``vat_mart``: VAT-Mart (Wu et al., ICLR 2022) on key frames, the open-loop row of AdaManip's table.

Where on the object, and along which trajectory, is decided by the first observation alone; what happens then is not
looked at. What is hidden it can only guess: given a lucky draw it opens, else it does not.

Sources: the method's released code (`warshallrho/VAT-Mart`) for modules and losses; AdaManip, section 5, for what its
row is ("predicts the open-loop trajectories from the one-frame passive observation").

==============================================  ======================================================================
published                                       here
==============================================  ======================================================================
features of a point, f_p                        `affordance.PlaceFeatures`, one per module
proposal, a conditional VAE:                    `affordance.ConditionalVAE`, `VatMartNetwork.proposal_loss`
``0.02 KL + 100 L1 + 5 geodesic``
scorer C: ``BCE(C, success)``                   `affordance.Score`, `VatMartPolicy._score_loss`
actionability D: ``L1(D, mean of the best C)``  `affordance.Score` of a place alone, `VatMartPolicy._actionability_loss`
test: D's best point, C's best of 100           `VatMartPolicy.predict_action_chunk`
==============================================  ======================================================================

Deviations
----------
- **Data.** Demonstrations instead of the rollouts of a reinforcement-learning policy with curiosity: the experts are
  the exploration. The task is "open it", so a scalar task and hindsight relabelling by the measured motion are void.
- **Success of a trajectory** is the share of the same task's episodes that its motion would open (`labels`), instead of
  one rollout's outcome: the scorer learns that a long turn opens more of them than a short one.
- **Negatives of the scorer** are turned or shifted grasps and the same numbers at places elsewhere, of demonstrations
  and of what the VAE makes of them, instead of the same trajectory under another task.
- **A trajectory** is a grasp (rotation 6D, offset of the tool from the contact point, opening to approach with) and
  eight key frames relative to it, instead of four waypoints with Euler angles. No part mask is given.
- **Weights of the proposal's loss** are 0.3, 3 for a grasp, 1 for each key frame's position and rotation, and 1.5,
  since offsets are given in units of 5 cm and relative positions in 15 cm. 1.5 nats of the divergence cost nothing
  (free bits, Kingma et al. 2016). Latent numbers are 8 instead of 128, which a few hundred demonstrations can fill.
- **Networks** are PointNets over 256 points and over the 64 around a place, with ReLU in encoder and decoder, instead
  of one PointNet++ on 10,000 points per module and linear layers.
- **Training.** All modules at once, each against the others without their gradient, instead of one after the other;
  actionability by the best 2 of 20 proposals instead of 5 of 100, and by cross-entropy instead of L1, which lets it
  die at zero; AdamW with a cosine instead of Adam with steps.
- **Behind the plan's end** the tool stays where it is until the episode ends.
"""
