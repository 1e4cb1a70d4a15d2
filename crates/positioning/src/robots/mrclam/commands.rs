//! Odometry commands held until the next, and their integrals.

use super::recording::Command;

/// Distance (m) and angle (rad) driven, as commanded; negative back in time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Driven {
    /// Distance along the heading (m).
    pub distance: f64,
    /// Turn (rad).
    pub turn: f64,
}

/// The integrals of one robot's commands, which the robot follows `delay` seconds late.
#[derive(Clone, Debug)]
pub struct Commands {
    delay: f64,
    times: Vec<f64>,
    distance: Vec<f64>,
    turn: Vec<f64>,
}

impl Commands {
    /// Integrates commands (times never falling, at least one) from the first on; before it and after the last the
    /// robot stands.
    ///
    /// Linear time.
    pub fn new(commands: &[Command], delay: f64) -> Self {
        let integral = |rate: fn(&Command) -> f64| {
            let mut sum = 0.0;
            let steps = commands.windows(2).map(|pair| rate(&pair[0]) * (pair[1].time - pair[0].time));
            let sums = steps.map(|step| {
                sum += step;
                sum
            });
            std::iter::once(0.0).chain(sums).collect()
        };
        let distance = integral(|command| command.speed);
        let turn = integral(|command| command.turn_rate);
        Self { delay, times: commands.iter().map(|command| command.time).collect(), distance, turn }
    }

    /// What the robot drives from one time to another (s); logarithmic time.
    pub fn between(&self, from: f64, to: f64) -> Driven {
        let (from, to) = (self.at(from), self.at(to));
        Driven { distance: to.distance - from.distance, turn: to.turn - from.turn }
    }

    fn at(&self, time: f64) -> Driven {
        let time = time - self.delay;
        let after = self.times.partition_point(|&other| other <= time);
        let last = self.times.len() - 1;
        if after == 0 || after > last {
            let end = if after == 0 { 0 } else { last };
            return Driven { distance: self.distance[end], turn: self.turn[end] };
        }
        let before = after - 1;
        let share = (time - self.times[before]) / (self.times[after] - self.times[before]);
        let blend = |sums: &[f64]| sums[before] + share * (sums[after] - sums[before]);
        Driven { distance: blend(&self.distance), turn: blend(&self.turn) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_are_held_delayed_and_ended() {
        let row = |time, speed, turn_rate| Command { time, speed, turn_rate };
        let rows = [row(1.0, 2.0, 0.0), row(2.0, 1.0, 0.5), row(2.0, 3.0, 1.0), row(4.0, 9.0, 9.0)];
        let commands = Commands::new(&rows, 0.5);
        let close = |from, to, distance: f64, turn: f64| {
            let driven = commands.between(from, to);
            assert!((driven.distance - distance).abs() < 1e-12 && (driven.turn - turn).abs() < 1e-12);
        };
        close(1.5, 2.0, 1.0, 0.0);
        close(2.0, 3.5, 1.0 + 3.0, 1.0);
        close(3.5, 2.0, -4.0, -1.0);
        close(0.0, 1.5, 0.0, 0.0);
        close(4.5, 100.0, 0.0, 0.0);
    }
}
