// Steps by a module of the page: the numbers after each step, as Python's environments report them; and the returns of
// the trained agent's episodes on juggle.
async ([module, words, cases, starts]) => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const text = (array) => btoa(Array.from(new Uint8Array(array.buffer), (byte) => String.fromCharCode(byte)).join(""));
  const physics = await loadPhysics(bytes(module), data);
  const steps = cases.map(({ task, values, dt, shares }) => {
    const desk = physics.makeDesk();
    desk.setScene(values);
    let [state, time] = [desk.start(words.map(BigInt)), 0];
    const [numbers, observations] = [[], []];
    for (const share of shares) {
      if (!desk.step(state, time, dt, share === null ? null : share * values[data.limit])) break;
      state = desk.after.slice();
      numbers.push(...state, ...["HITS", "IMPULSE", "MEAN_TORQUE"].map(desk.number), desk.reward(task));
      for (const { since, wall, foot, impulse } of desk.impacts()) numbers.push(time + since, wall, foot, impulse);
      observations.push(...desk.observation);
      time += dt;
    }
    return [text(Float64Array.from(numbers)), text(Float32Array.from(observations))];
  });
  const desk = physics.makeDesk();
  const { agent } = data.tasks.juggle;
  const weights = Float32Array.from(new Int16Array(bytes(agent.weights).buffer), (weight) => weight * agent.scale);
  const act = desk.agent({ ...agent, weights });
  desk.setScene(data.values);
  const returns = starts.map((start) => {
    desk.place(desk.start(start.map(BigInt)), 0.02, "juggle");
    act.restart();
    let sum = 0;
    for (let step = 0; step < 500; step++) {
      const torque = act() * data.values[data.limit];
      desk.step(desk.after.slice(), 0.02 * step, 0.02, torque);
      sum += desk.reward("juggle");
    }
    return sum;
  });
  return { steps, returns };
}
