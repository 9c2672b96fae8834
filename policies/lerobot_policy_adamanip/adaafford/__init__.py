"""The policy ``adaafford``: AdaAfford (Wang et al., ECCV 2022) on key frames, the row of AdaManip's table that adapts.

What its own interactions have told is condensed to a vector z, by which the success of the next is predicted; the first
few are also chosen for what they would tell. One interaction is one motion in contact.

Sources: the method's released code (`wangyian-me/AdaAffordCode`) for modules and losses; AdaManip, section 5, for what
its row is ("adjusts the manipulation policy based on history interactions using CVAE").

==============================================  ======================================================================
published                                       here
==============================================  ======================================================================
z, a mean of interactions weighted by attention `network.AdaAffordNetwork.concluded`
AAP, success given z: ``BCE(C, success)``       `AdaAffordPolicy._success_error`
AIP, information: ``L1(G, CE without - CE       `AdaAffordPolicy._information_error`
with)``
maps: best 3 of C; best 5 of G and of C         `AdaAffordPolicy._map_error`
actor (Where2Act's proposals)                   `affordance.ConditionalVAE`, `AdaAffordPolicy._actor_error`
test: explore up to 4 times, then exploit       `AdaAffordPolicy._decided`
==============================================  ======================================================================

Deviations
----------
- **Data.** Adaptive demonstrations are sequences of interactions under one hidden state; no others are made. The turns
  in which AIP chooses interactions in a simulator, and AAP learns from them, are left out.
- **What was felt** stands for the part's motion and joint, which were read from the simulator: the pose commanded,
  what was left undone of it, and the gripper (`events`).
- **Success is "nearer to open"** instead of "it moved": a try that did not fail (``complementary_info.tried`` and
  ``.failed``), and not its way back, which no expert goes. Otherwise the policy could turn back and forth for ever.
- **Which outcomes are asked for**: those of the row's stretch, in which nothing moved (`interactions`), instead of 32
  random ones; objects are not reset between interactions. z is of all interactions before, and of all but the latest.
- **Order**: an interaction's number is among what is told of it, since turning after pulling is not pulling after
  turning.
- **The cloud** is the present one also for interactions that have been, instead of one cloud of an object at rest.
- **Actions elsewhere**: at places where nobody has taken hold, success and information are taught to be none, of
  actions that were made elsewhere and of what the actor proposes there.
- **Taking hold anew** costs key frames, so that what is held is kept unless another place promises 0.1 more. Among the
  candidates are the last motion again, and the way back.
- **The actor** is a conditional VAE that learns from tries, without z; the choice among its proposals is C's and G's.
  Two nats of its divergence cost nothing (free bits, Kingma et al. 2016).
- **Networks** are PointNets over 256 points and over the 32 around a place instead of one PointNet++ on 10,000 points
  per module; all modules are trained at once; AdamW with a cosine instead of Adam with steps. The success map learns by
  cross-entropy instead of L1, which lets it die at zero.
"""
