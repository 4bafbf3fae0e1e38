// matter.js 0.20 (npm matter-js): Verlet steps in double precision, separating axes of polygons, impulses in turn.
// Law: a substep moves, finds overlapping parts, pushes them apart and turns their relative velocity to -e times it.
// Settings: "resting" is Resolver._restingThresh, below which a contact is inelastic; "dampen" Resolver._positionDampen,
// the part of an overlap beyond "slop" that is pushed apart. No friction, no air. Time is in ms, as the engine expects.
// The jack is the square whose corners are the feet. Walls are as thick as the half width.
// It cannot bounce two feet off one wall at once: they share the impulse of one. It offers no continuous collision.
const Matter = require("matter-js"), { main, directions } = require("./playing.js");
const { Bodies, Body, Composite, Engine, Resolver } = Matter;

function make(scene, start, h, settings) {
  const { box_half_width: half, jack_arm: arm } = scene, ms = 1000 * h; // its unit of time
  const { resting, dampen, slop, positionIterations, velocityIterations } = settings;
  Resolver._restingThresh = resting, Resolver._positionDampen = dampen;
  const engine = Engine.create({ gravity: { x: 0, y: 0, scale: 0 }, positionIterations, velocityIterations });
  const material = { friction: 0, frictionStatic: 0, frictionAir: 0, slop, restitution: scene.restitution };
  const walls = directions.map(([x, y]) =>
    Bodies.rectangle(1.5 * x * half, 1.5 * y * half, x ? half : 4 * half, y ? half : 4 * half),
  );
  const box = Body.create({ parts: [...walls], ...material });
  const jack = Bodies.fromVertices(0, 0, [directions.map(([x, y]) => ({ x: x * arm, y: y * arm }))], material);
  const place = (body, at, mass, inertia) => {
    Body.setMass(body, mass), Body.setInertia(body, inertia);
    Body.setPosition(body, { x: start[at], y: start[at + 1] }), Body.setAngle(body, start[at + 2]);
    body.deltaTime = ms; // of the last step: velocities are stored as the way in it
    const rate = (index) => (start[index] / 1000) * Body._baseDelta;
    Body.setVelocity(body, { x: rate(at + 6), y: rate(at + 7) }), Body.setAngularVelocity(body, rate(at + 8));
  };
  place(box, 0, scene.box_mass, scene.box_inertia), place(jack, 3, scene.jack_mass, scene.jack_inertia);
  Composite.add(engine.world, [box, jack]);
  const footOf = ({ x, y }) =>
    (Math.round((Math.atan2(y - jack.position.y, x - jack.position.x) - jack.angle) / (Math.PI / 2)) % 4 + 4) % 4;
  const step = (torque) => {
    const pushed = [];
    box.torque = 1e-6 * torque, jack.force.y = -1e-6 * scene.gravity * scene.jack_mass;
    Engine.update(engine, ms);
    for (const { isActive, contacts, contactCount, bodyA, bodyB } of engine.pairs.list) {
      const wall = walls.indexOf(bodyA) + walls.indexOf(bodyB) + 1; // the other is the jack, at -1
      for (const { vertex } of isActive ? contacts.slice(0, contactCount) : []) pushed.push(4 * wall + footOf(vertex));
    }
    return pushed;
  };
  const at = ({ position, angle }) => [position.x, position.y, angle];
  const rates = ({ position, positionPrev, angle, anglePrev }) =>
    [position.x - positionPrev.x, position.y - positionPrev.y, angle - anglePrev].map((way) => way / h);
  return { step, state: () => [...at(box), ...at(jack), ...rates(box), ...rates(jack)] };
}
make.late = true; // contacts are found after the substep's motion

main(make);
