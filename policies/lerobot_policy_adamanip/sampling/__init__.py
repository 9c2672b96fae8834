"""The policy ``sampling``: random macro actions without a memory, the first row of AdaManip's table.

AdaManip, appendix: "samples a macro action from a discrete set at each high-level time step and then plans to the
sub-goal pose ... computed based on the object part pose annotation". A hand that holds something draws uniformly among
all motions and a new grasp; an empty one grasps. No result of a try changes the draw.

======================================  =============================================================================
published                               here
======================================  =============================================================================
discrete set of macro actions           `motion_clusters.cluster_motions` of motions in contact, and their reverse
sub-goal pose by the part's annotation  affordance and grasp learnt from contacts: `modeling_sampling.SamplingNetwork`
draw                                    `modeling_sampling.SamplingPolicy.draw_macro`
======================================  =============================================================================

Deviations
----------
- **Grasps** are predicted from observations, since no part poses are given; they are less exact.
- **The set of motions**, not published, comes from the data and is closed under reversal: half of them close.
- **The budget**, not published, decides the success rate: here it is the environment's limit of key frames.
"""
