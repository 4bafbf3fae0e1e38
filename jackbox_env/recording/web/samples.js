// -- the samples: decoded, and interpolated in time -------------------------------------------------------------------
// A row is [time, 6 places, 6 rates, torque, energy, work]. Two rows have one time where there is an impact.

const rows = unpacked(data.samples, Float64Array);
const COUNT = rows.length / WIDTH;
const START = rows[0];
const END = rows[(COUNT - 1) * WIDTH];
const LASTS = END - START;
const at = (row, column) => rows[row * WIDTH + column];

// The row's numbers at a time, into `into`: places by the cubic through both places and rates, the rest by a line.
function sampleAt(time, into) {
  const row = rowAt(time);
  const next = Math.min(row + 1, COUNT - 1);
  const step = at(next, 0) - at(row, 0);
  const share = step > 0 ? Math.min(Math.max((time - at(row, 0)) / step, 0), 1) : 0;
  const rest = 1 - share;
  into[0] = time;
  for (let column = 1; column <= 6; column++) {
    into[column] =
      rest * rest * ((1 + 2 * share) * at(row, column) + share * step * at(row, column + 6)) +
      share * share * ((1 + 2 * rest) * at(next, column) - rest * step * at(next, column + 6));
  }
  for (let column = 7; column < WIDTH; column++) into[column] = rest * at(row, column) + share * at(next, column);
  into[COLUMN.torque] = at(next, COLUMN.torque); // a mean since the row before
  return into;
}

// All impacts, each with the place of its foot in the box's own frame.
const impulses = unpacked(data.impulses, Float64Array);
const meetings = unpacked(data.meetings, Uint8Array); // 4 times the wall, and the foot
const impacts = Array.from(unpacked(data.impacts, Float64Array), (time, number) => {
  const [wall, foot, impulse] = [meetings[number] >> 2, meetings[number] & 3, impulses[number]];
  return { time, wall, foot, impulse, ...placeOf(sampleAt(time, new Float64Array(WIDTH)), foot) };
});
