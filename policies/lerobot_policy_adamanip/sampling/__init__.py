"""The policy ``sampling``: random macro actions without a memory, the first row of AdaManip's table.

AdaManip, appendix: "samples a macro action from a discrete set at each high-level time step and then plans to the
sub-goal pose ... computed based on the object part pose annotation". Here it is a policy like any other, which sees
what they see: part poses are not given, so where and how to take hold is learnt from demonstrations, and what can be
done in contact are the demonstrations' typical motions, each one forwards and backwards. Which of them comes next is
drawn uniformly. Nothing that has been tried or felt changes the draw.

A hand that holds something draws among all motions, and taking hold anew; one that holds nothing takes hold. A macro
action is followed to its end; the next is drawn from the observation then.

======================================  =============================================================================
published                               here
======================================  =============================================================================
discrete set of macro actions           `motion_clusters.cluster_motions` of motions in contact, and their reverse
sub-goal pose by the part's annotation  affordance and grasp learnt from contacts: `modeling_sampling.SamplingNetwork`
draw                                    `modeling_sampling.SamplingPolicy.draw_macro`
======================================  =============================================================================

Deviations
----------
- **Grasps are predicted** instead of computed from annotations, so that a policy stays one; they are less exact.
- **The set of motions** is not published. Ours comes from the data and is closed under reversal, so that both
  directions are drawn equally often whatever was demonstrated; half of the motions that open therefore close.
- **The budget** of macro actions is not published, and decides: given time, random motions open most objects. Here it
  is the environment's limit of key frames; beside a success rate belongs the number of key frames.
"""
