// Joints by limb, from their names.

/** @type {[string, RegExp][]} */
const LIMBS = [
  ["Left hand", /left.*(hand|finger|thumb|index|middle|gripper)/], ["Right hand", /right.*(hand|finger|thumb|index|middle|gripper)/],
  ["Left arm", /left.*(shoulder|elbow|wrist|arm)/], ["Right arm", /right.*(shoulder|elbow|wrist|arm)/],
  ["Left leg", /left.*(hip|knee|ankle|thigh|calf|leg)/], ["Right leg", /right.*(hip|knee|ankle|thigh|calf|leg)/],
  ["Front left leg", /^fl_/], ["Front right leg", /^fr_/], ["Rear left leg", /^rl_/], ["Rear right leg", /^rr_/],
  ["Waist", /waist|torso|trunk/], ["Head", /head|neck/],
];

/** @param {string[]} joints @returns {Map<string, number[]>} limb and places of its joints */
export function byLimb(joints) {
  /** @type {Map<string, number[]>} */
  const limbs = new Map();
  joints.forEach((joint, place) => {
    const name = joint.toLowerCase();
    const limb = LIMBS.find(([, pattern]) => pattern.test(name))?.[0] ?? "Joints";
    const places = limbs.get(limb) ?? [];
    places.push(place);
    limbs.set(limb, places);
  });
  return limbs;
}
