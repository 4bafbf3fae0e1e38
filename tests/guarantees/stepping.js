// Steps by a module of the page: the numbers after each step, as Python's environments report them; and the returns of
// episodes of the trained agents.
async ([module, words, cases, episodes]) => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const text = (array) => btoa(Array.from(new Uint8Array(array.buffer), (byte) => String.fromCharCode(byte)).join(""));
  const physics = await loadPhysics(bytes(module), data);
  const steps = cases.map(({ task, values, dt, shares }) => {
    const buffer = physics.makeBuffer();
    buffer.setScene(values);
    let [state, time] = [buffer.start(words.map(BigInt)), 0];
    const [numbers, observations] = [[], []];
    for (const share of shares) {
      if (!buffer.step(state, time, dt, share === null ? null : share * values[data.torqueLimit])) break;
      state = buffer.after.slice();
      numbers.push(...state, ...["HITS", "IMPULSE", "MEAN_TORQUE"].map((name) => buffer.number(name)), buffer.reward(task));
      for (const { since, wall, foot, impulse } of buffer.impacts()) numbers.push(time + since, wall, foot, impulse);
      observations.push(...buffer.observe());
      time += dt;
    }
    return [text(Float64Array.from(numbers)), text(Float32Array.from(observations))];
  });
  const buffer = physics.makeBuffer();
  const acts = Object.entries(data.tasks).map(([task, { agent }]) => {
    const weights = Float32Array.from(new Int16Array(bytes(agent.weights).buffer), (weight) => weight * agent.scale);
    return [task, buffer.agent({ ...agent, weights })];
  });
  buffer.setScene(data.values);
  const returns = episodes.map(([task, start]) => {
    const act = Object.fromEntries(acts)[task];
    buffer.place(buffer.start(start.map(BigInt)), 0.02, task);
    act.restart();
    let sum = 0;
    for (let step = 0; step < 500; step++) {
      const share = act();
      buffer.step(buffer.after.slice(), 0.02 * step, 0.02, share * data.values[data.torqueLimit]);
      sum += buffer.reward(task);
    }
    return sum;
  });
  return { steps, returns };
}
