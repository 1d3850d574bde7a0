// A ROS 2 node that tracks a reference: nav_msgs/Odometry in, geometry_msgs/WrenchStamped or setpoints out.
#include <chrono>
#include <fstream>
#include <memory>
#include <optional>
#include <string>

#include <geometry_msgs/msg/wrench_stamped.hpp>
#include <nav_msgs/msg/odometry.hpp>
#include <rclcpp/rclcpp.hpp>
#include <std_msgs/msg/float64.hpp>

#include "auv_gym_controller/controller.hpp"

namespace auv_gym_controller {

class ControllerNode : public rclcpp::Node {
 public:
  ControllerNode() : Node("auv_gym_controller") {
    const auto axes = declare_parameter<std::string>("axes", "enu");  // ROS; or "ned" with body axes ahead, right, down
    if (axes != "enu" && axes != "ned") throw std::invalid_argument("axes is " + axes + "; allowed are enu, ned");
    ned_ = axes == "ned";
    const auto output = declare_parameter<std::string>("output", "wrench");
    if (output != "wrench" && output != "setpoints") {
      throw std::invalid_argument("output is " + output + "; allowed are wrench, setpoints");
    }
    const auto file = declare_parameter<std::string>("reference", "reference.csv");
    std::ifstream stream(file);
    if (!stream) throw std::invalid_argument("cannot read " + file);
    const Command limits = {declare_parameter<double>("F_u_max", 400.0), declare_parameter<double>("F_r_max", 200.0)};
    const auto period = declare_parameter<double>("period", 0.1);
    const auto fin = declare_parameter<double>("fin", 0.0);
    const auto patience = declare_parameter<double>("patience", 1.0);
    controller_ = std::make_unique<Controller>(read_reference(stream), limits, period, fin, patience);
    if (output == "setpoints") {
      heading_ = create_publisher<std_msgs::msg::Float64>("heading", 10);
      speed_ = create_publisher<std_msgs::msg::Float64>("speed", 10);
    } else {
      publisher_ = create_publisher<geometry_msgs::msg::WrenchStamped>("wrench", 10);
    }
    subscription_ = create_subscription<nav_msgs::msg::Odometry>(
        "odometry", rclcpp::SensorDataQoS(), [this](const nav_msgs::msg::Odometry& message) { measured_ = message; });
    timer_ = create_wall_timer(std::chrono::duration<double>(period), [this] { step(); });
  }

 private:
  Measurement converted(const nav_msgs::msg::Odometry& message) const {
    const auto& p = message.pose.pose.position;
    const auto& q = message.pose.pose.orientation;
    const auto& v = message.twist.twist;
    const double heading = yaw(q.x, q.y, q.z, q.w);
    if (ned_) return from_ned(p.x, p.y, heading, v.linear.x, v.linear.y, v.angular.z);
    return {p.x, p.y, heading, v.linear.x, v.linear.y, v.angular.z};
  }

  void step() {
    if (!started_ && !measured_) return;  // the reference begins with the first measurement
    started_ = true;
    std::optional<Measurement> measurement;
    if (measured_) measurement = converted(*measured_);
    measured_.reset();
    Command command = controller_->step(measurement ? &*measurement : nullptr);
    if (controller_->status() == Status::stopped) {
      RCLCPP_WARN_THROTTLE(get_logger(), *get_clock(), 1000, "no measurement: zero force");
    }
    if (heading_) {
      const Setpoints setpoints = controller_->setpoints();
      std_msgs::msg::Float64 heading, speed;
      heading.data = ned_ ? -setpoints.heading : setpoints.heading;
      speed.data = setpoints.speed;
      heading_->publish(heading);
      speed_->publish(speed);
      return;
    }
    if (ned_) command = to_ned(command);
    geometry_msgs::msg::WrenchStamped message;
    message.header.stamp = now();
    message.header.frame_id = "base_link";
    message.wrench.force.x = command.F_u;
    message.wrench.torque.z = command.F_r;
    publisher_->publish(message);
  }

  bool ned_ = false, started_ = false;
  std::optional<nav_msgs::msg::Odometry> measured_;  // since the last step
  std::unique_ptr<Controller> controller_;
  rclcpp::Publisher<geometry_msgs::msg::WrenchStamped>::SharedPtr publisher_;
  rclcpp::Publisher<std_msgs::msg::Float64>::SharedPtr heading_, speed_;
  rclcpp::Subscription<nav_msgs::msg::Odometry>::SharedPtr subscription_;
  rclcpp::TimerBase::SharedPtr timer_;
};

}  // namespace auv_gym_controller

int main(int argc, char** argv) {
  rclcpp::init(argc, argv);
  rclcpp::spin(std::make_shared<auv_gym_controller::ControllerNode>());
  rclcpp::shutdown();
  return 0;
}
