// -- the physics: the compiled module, and buffers that it works in ------------------------------------------------------

const STACK = 131072; // [bytes] of the stack, which grows down; buffers lie beyond it

const { sin, cos, tanh } = Math;

async function loadPhysics(bytes, { offsets, impactsAt, length, mostImpacts, observed, workspace }) {
  const memory = new WebAssembly.Memory({ initial: 16 });
  const unsigned = (value) => BigInt.asUintN(64, value);
  const env = {
    __linear_memory: memory,
    __stack_pointer: new WebAssembly.Global({ value: "i32", mutable: true }, STACK),
    fmod: (a, b) => a % b, // exact, as in C
    sin, cos, // of angles beyond 2^53
    tanh, // in the agent
    __multi3: (to, a, aHigh, b, bHigh) => {
      const product = unsigned(a) * unsigned(b) + (unsigned(a * bHigh + aHigh * b) << 64n);
      new BigUint64Array(memory.buffer, to, 2).set([unsigned(product), unsigned(product >> 64n)]);
    },
  };
  const { exports } = (await WebAssembly.instantiate(bytes, { env })).instance;
  let free = STACK;
  const allocate = (Kind, count) => {
    const array = new Kind(memory.buffer, free, count);
    free += 8 * Math.ceil(array.byteLength / 8);
    return array;
  };
  const answer = allocate(Float64Array, 8); // of calls, and their errors
  const call = (name, ...values) => {
    const failed = exports[name](answer.byteOffset, answer.byteOffset + 32, ...values.map((one) => one.byteOffset ?? one));
    if (failed) throw new Error(`${name} has failed: ${failed}`);
  };
  const [words, zero] = [allocate(BigUint64Array, 4), allocate(BigInt64Array, 1)];

  // A buffer: a state before and after a step, its scene and its impacts.
  function makeBuffer() {
    const [buffer, scratch] = [allocate(Float64Array, length), allocate(Uint8Array, workspace)];
    const observation = allocate(Float32Array, observed);
    const part = (name, count) => buffer.subarray(offsets[name], offsets[name] + count);
    const [scene, before, after] = [part("SCENE", 13), part("BEFORE", 12), part("AFTER", 12)];
    const write = (numbers) => Object.entries(numbers).forEach(([name, value]) => (buffer[offsets[name]] = value));
    return {
      scene, after,
      number: (name, k = 0) => buffer[offsets[name] + k],
      setScene(values) {
        scene.set(values);
        call("derive", buffer);
      },
      // Put a state there, as after a step without torque and impacts.
      place(state, dt, task) {
        after.set(state);
        write({ DT: dt, HITS: 0, MEAN_TORQUE: 0, IMPULSE: 0 });
        this.reward(task);
      },
      // Step `from` by `dt` [s] under a torque [N m], or under the chirp (null). False: the step failed.
      step(from, time, dt, torque) {
        before.set(from);
        write({ DT: dt, KIND: torque === null ? 1 : 0, TIME: time, TORQUE: torque ?? 0 });
        call("step", buffer, scratch);
        return buffer[offsets.STATUS] === 0;
      },
      impacts: (most = mostImpacts) => Array.from({ length: Math.min(buffer[offsets.HITS], most) }, (_, row) => {
        const [since, wall, foot, impulse] = buffer.subarray(impactsAt + 4 * row, impactsAt + 4 * row + 4);
        return { since, wall, foot, impulse };
      }),
      start(generator) {
        words.set(generator);
        call("start", buffer, zero, words);
        return after.slice();
      },
      // The smallest gap of a state [m].
      gap(state) {
        before.set(state);
        call("measure", buffer);
        return buffer[offsets.GAP];
      },
      // What a trained policy observes of `after`.
      observe() {
        call("observe", buffer, observation);
        return observation;
      },
      reward(task) {
        call(`score_${task}`, buffer);
        return 0 + buffer[offsets.REWARDS] + buffer[offsets.REWARDS + 1];
      },
      // A trained policy: a function that returns its share of the torque limit in the step from `after`.
      agent({ weights, hidden, outputs, longest, max_contact_steps }) {
        const [stored, values] = [allocate(Float32Array, weights.length), allocate(Float64Array, observed + 2 * hidden + outputs)];
        stored.set(weights);
        const act = () => {
          call("act", buffer, this.observe(), stored, values, ...[hidden, outputs, longest, max_contact_steps].map(BigInt));
          return buffer[offsets.SHARE];
        };
        return Object.assign(act, { restart: () => write({ STEPS: -1 }) });
      },
    };
  }
  return { makeBuffer };
}
