// Rapier 2D 0.21 (npm @dimforge/rapier2d-compat, WebAssembly): soft contacts, projected Gauss-Seidel, single precision.
// Law: a step finds the contacts nearer than the prediction distance, then solves and moves "inner" times.
// Settings: those of its IntegrationParameters, "inner" for numSolverIterations; the feet's "radius" over L; "ccd". The
// larger restitution counts; no friction, no sleeping. Walls are as thick as the half width, set back by the radius.
// It cannot compute in double precision.
const RAPIER = require("@dimforge/rapier2d-compat"), { main, directions } = require("./playing.js");
const NAMES = ["lengthUnit", "contact_natural_frequency", "normalizedPredictionDistance", "normalizedAllowedLinearError"];
NAMES.push("numInternalPgsIterations");

function make(scene, start, h, settings) {
  const { box_half_width: half, restitution } = scene, radius = settings.radius * half;
  const world = new RAPIER.World({ x: 0, y: -scene.gravity });
  world.timestep = h;
  world.integrationParameters.numSolverIterations = settings.inner;
  for (const name of NAMES) world.integrationParameters[name] = settings[name];
  const body = (at, mass, inertia, scale) =>
    world.createRigidBody(
      RAPIER.RigidBodyDesc.dynamic()
        .setTranslation(start[at], start[at + 1]).setRotation(start[at + 2])
        .setLinvel(start[at + 6], start[at + 7]).setAngvel(start[at + 8])
        .setAdditionalMassProperties(mass, { x: 0, y: 0 }, inertia)
        .setGravityScale(scale).setCanSleep(false).setCcdEnabled(settings.ccd),
    );
  const box = body(0, scene.box_mass, scene.box_inertia, 0), jack = body(3, scene.jack_mass, scene.jack_inertia, 1);
  const pairs = new Map(), add = (shape, [x, y], far, of) =>
    world.createCollider(
      shape.setTranslation(x * far, y * far).setDensity(0).setFriction(0).setRestitution(restitution)
        .setRestitutionCombineRule(RAPIER.CoefficientCombineRule.Max)
        .setActiveEvents(RAPIER.ActiveEvents.CONTACT_FORCE_EVENTS).setContactForceEventThreshold(0),
      of,
    ).handle;
  directions.forEach((way, number) => { // walls as thick as the box's half width
    const size = way[0] ? [half / 2, 2 * half] : [2 * half, half / 2];
    pairs.set(add(RAPIER.ColliderDesc.cuboid(...size), way, 1.5 * half + radius, box), number);
    pairs.set(add(RAPIER.ColliderDesc.ball(radius), way, scene.jack_arm, jack), 4 + number);
  });
  const events = new RAPIER.EventQueue(true);
  const step = (torque) => {
    const pushed = [];
    box.resetTorques(true), box.addTorque(torque, true);
    world.step(events);
    events.drainContactForceEvents((event) => {
      const [one, other] = [pairs.get(event.collider1()), pairs.get(event.collider2())];
      if (event.totalForceMagnitude() > 0) pushed.push(4 * Math.min(one, other) + Math.max(one, other) - 4);
    });
    return pushed;
  };
  const half_state = (of) => [of.translation().x, of.translation().y, of.rotation()];
  const rates = (of) => [of.linvel().x, of.linvel().y, of.angvel()];
  const state = () => [...half_state(box), ...half_state(jack), ...rates(box), ...rates(jack)];
  return { step, state, free: () => (events.free(), world.free()) };
}

RAPIER.init().then(() => main(make));
