"""The policy ``sampling``: random macro actions without a memory, the first row of AdaManip's table.

AdaManip, appendix: "samples a macro action from a discrete set at each high-level time step and then plans to the
sub-goal pose ... computed based on the object part pose annotation". A hand that holds something draws uniformly from
all motions and a new grasp; an empty hand grasps. Results of tries do not change the draw.

======================================  =============================================================================
published                               here
======================================  =============================================================================
discrete set of macro actions           `motion_clusters.cluster_motions` of motions in contact, and their reverse
sub-goal pose by the part's annotation  affordance and grasp learnt from contacts: `modeling_sampling.SamplingNetwork`
draw                                    `modeling_sampling.SamplingPolicy.draw_macro`
======================================  =============================================================================

Deviations
----------
- **Grasps** are predicted from observations, because part poses are not available; they are less exact.
- **The set of motions** is not published; here it comes from the data, with every motion's reverse: half of them close.
- **The budget** decides the success rate and is not published; here it is the environment's limit of key frames.
"""
