// The control loop around an exported agent, without ROS: reference, axes, missing measurements, one step a period.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <istream>
#include <sstream>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "auv_gym_controller/agent.h"

namespace auv_gym_controller {

/// Position [m], heading [rad], velocities over ground in body axes [m/s], yaw rate [rad/s]. Axes as in ROS: x east (or
/// any fixed direction), y to the left of it, angles counter-clockwise; u ahead, v to port. NaN where it is missing.
struct Measurement {
  double x, y, psi, u, v, r;
};

/// Surge force [N] ahead and yaw moment [N m], counter-clockwise.
struct Command {
  double F_u = 0.0, F_r = 0.0;
};

/// Heading [rad], counter-clockwise from the x axis of the reference, and surge speed [m/s], for a vehicle that takes
/// setpoints and an agent that was trained for them, docs/setpoints.md.
struct Setpoints {
  double heading = 0.0, speed = 0.0;
};

/// `tracking`: computed from a new measurement. `repeated`: the last command, since the measurement is missing.
/// `stopped`: zero, since measurements have been missing for too long. `finished`: zero, the reference has ended.
enum class Status { tracking, repeated, stopped, finished };

/// Returns a measurement in NED (heading clockwise from north, sway to starboard) in the axes above, x north, y west.
inline Measurement from_ned(double north, double east, double heading, double surge, double sway, double yaw_rate) {
  return {north, -east, -heading, surge, -sway, -yaw_rate};
}

/// Returns a command in NED body axes: the yaw moment is positive to starboard.
inline Command to_ned(const Command& command) { return {command.F_u, -command.F_r}; }

/// Returns the heading [rad] of a quaternion, counter-clockwise from x if z points up.
inline double yaw(double x, double y, double z, double w) {
  return std::atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z));
}

/// x, y [m], psi [rad], u, v [m/s], r [rad/s], F_u [N], F_r [N m] of the reference, one row for each control period.
using Row = std::array<double, 8>;

/// Reads rows of eight numbers, separated by commas; lines that begin with # are comments.
inline std::vector<Row> read_reference(std::istream& stream) {
  std::vector<Row> rows;
  for (std::string line; std::getline(stream, line);) {
    if (line.empty() || line[0] == '#') continue;
    std::istringstream text(line);
    Row row;
    for (std::size_t i = 0; i < row.size(); i++) {
      std::string cell;
      if (!std::getline(text, cell, ',')) throw std::runtime_error("reference: a row has fewer than 8 numbers");
      row[i] = std::stod(cell);
    }
    if (std::string more; std::getline(text, more)) throw std::runtime_error("reference: a row has more than 8 numbers");
    rows.push_back(row);
  }
  return rows;
}

class Controller {
 public:
  /// `limits`: largest |F_u| [N] and |F_r| [N m]. `period`: control period [s]. `fin`: yaw moment of full fins over the
  /// squared surge speed [kg], 0 without fins. `patience`: how long [s] a command is repeated without a measurement.
  Controller(std::vector<Row> reference, const Command& limits, double period, double fin = 0.0, double patience = 1.0)
      : reference_(std::move(reference)), limits_(limits), period_(period), fin_(fin), patience_(patience) {
    if (reference_.size() <= PREVIEW.back()) throw std::runtime_error("reference: it is shorter than the preview");
    auv_agent_start(&memory_);
  }

  /// Returns the command of the next control period. Call it once in each period, with nullptr if no measurement came.
  Command step(const Measurement* measured) {
    const std::size_t k = k_++;
    if (k + PREVIEW.back() >= reference_.size()) return set(Status::finished, {});
    Measurement m = measured != nullptr ? *measured : Measurement{NAN, NAN, NAN, NAN, NAN, NAN};
    hold_position(m);
    if (!std::isfinite(m.x + m.y + m.psi + m.u + m.v + m.r)) {
      missing_ += period_;
      return missing_ > patience_ ? set(Status::stopped, {}) : set(Status::repeated, command_);
    }
    if (missing_ > patience_) auv_agent_start(&memory_);  // its memory is too old
    missing_ = 0.0;
    return set(Status::tracking, command(k, m));
  }

  Status status() const { return status_; }

  /// Returns the setpoints of the last command: the heading of the reference and speed 0 if the command is zero.
  Setpoints setpoints() const {
    constexpr double largest_turn = 1.5707963267948966;
    const Row& now = reference_[k_ > reference_.size() ? reference_.size() - 1 : k_ - (k_ > 0)];
    const bool moves = status_ == Status::tracking || status_ == Status::repeated;
    const double speed = moves ? now[3] * (1.0 + command_.F_u / limits_.F_u) : 0.0;
    return {now[2] + largest_turn * command_.F_r / moment_, speed};
  }

 private:
  /// Control periods ahead at which `helm` sees the reference; for another agent see its header.
  static constexpr std::array<std::size_t, 4> PREVIEW = {5, 10, 20, 40};
  static_assert(sizeof(auv_agent_view::ahead) == 2 * PREVIEW.size() * sizeof(auv_agent_real), "another preview");
  /// [s] The longest outage of the position fix that is bridged.
  static constexpr double LONGEST_OUTAGE = 10.0;

  /// Share of the yaw moment that fins have at rest, for the agent, which divides by it.
  static constexpr double LEAST_SHARE = 1.0 / 64.0;

  /// Returns the largest yaw moment [N m] at a surge speed [m/s].
  double largest_moment(double u) const {
    const double share = fin_ * u * u / limits_.F_r;
    if (fin_ <= 0.0 || share >= 1.0) return limits_.F_r;
    return limits_.F_r * (share > LEAST_SHARE ? share : LEAST_SHARE);
  }

  /// Puts the last position fix in the place of a missing one, as in training.
  void hold_position(Measurement& m) {
    if (std::isfinite(m.x) && std::isfinite(m.y)) {
      fix_ = {m.x, m.y};
      outage_ = 0.0;
    } else if ((outage_ += period_) <= LONGEST_OUTAGE) {
      m.x = fix_[0];
      m.y = fix_[1];
    }
  }

  Command command(std::size_t k, const Measurement& m) {
    const Row& now = reference_[k];  // positions are relative to it: floats are too short for map coordinates
    const std::array<double, 6> measured = {m.x - now[0], m.y - now[1], m.psi, m.u, m.v, m.r};
    const std::array<double, 8> reference = {0.0, 0.0, now[2], now[3], now[4], now[5], now[6], now[7]};
    const std::array<double, 3> setting = {limits_.F_u, moment_ = largest_moment(m.u), period_};
    auv_agent_view view = {};
    copy(measured, view.measured);
    copy(reference, view.reference);
    copy(setting, view.setting);
    for (std::size_t i = 0; i < PREVIEW.size(); i++) {
      const Row& later = reference_[k + PREVIEW[i]];
      view.ahead[2 * i] = static_cast<auv_agent_real>(later[0] - now[0]);
      view.ahead[2 * i + 1] = static_cast<auv_agent_real>(later[1] - now[1]);
    }
    auv_agent_real share[2];
    auv_agent_steer(&memory_, &view, share);
    return {share[0] * setting[0], share[1] * setting[1]};
  }

  template <std::size_t N>
  static void copy(const std::array<double, N>& from, auv_agent_real (&to)[N]) {
    for (std::size_t i = 0; i < N; i++) to[i] = static_cast<auv_agent_real>(from[i]);
  }

  Command set(Status status, const Command& command) {
    status_ = status;
    return command_ = command;
  }

  std::vector<Row> reference_;
  Command limits_, command_;
  double period_, fin_, patience_, moment_ = 1.0, missing_ = 0.0, outage_ = 0.0;
  std::array<double, 2> fix_ = {NAN, NAN};
  std::size_t k_ = 0;
  Status status_ = Status::tracking;
  auv_agent_memory memory_ = {};
};

}  // namespace auv_gym_controller
