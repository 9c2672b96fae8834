"""The policy ``vat_mart``: VAT-Mart (Wu et al., ICLR 2022) on key frames, the open-loop row of AdaManip's table.

The policy chooses grasp and trajectory from the first observation; it can only guess hidden states. Sources:
released code (`warshallrho/VAT-Mart`) for modules and losses; AdaManip, section 5, for the row.

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
- **Data**: demonstrations instead of rollouts of a curious RL policy. The task is "open it": no task number, no
  hindsight relabelling.
- **Success of a trajectory**: the share of the same task's episodes that its motion opens (`plan_labels`).
- **Negatives of the scorer**: turned or shifted grasps, and trajectories elsewhere, of demonstrations and of the VAE.
- **A trajectory**: a grasp and eight key frames relative to it, instead of four waypoints with Euler angles. No part
  mask is given. After the last key frame the tool stays.
- **Proposal loss**: weights 0.3, 3 (grasp), 1 (each key frame's position and rotation) and 1.5, for units of 5 and
  15 cm; 1.5 nats of free bits (Kingma et al. 2016); 8 latent numbers instead of 128.
- **Networks**: PointNets on 256 points and on the 64 around a place, with ReLU, instead of a PointNet++ on 10,000.
- **Training**: all modules at once, without gradients between them; actionability by the best 2 of 20 proposals
  instead of 5 of 100, and by cross-entropy, since L1 drives it to zero; AdamW with a cosine.
"""
