// Times one manipulability sample in Pinocchio: forward kinematics, the joint Jacobian of the last joint
// and w = sqrt(det(J J^T)), for a 6-joint arm at random joint vectors.
//
//   pinocchio_loop SAMPLES THREADS [LIMIT_DEG]
//
// SAMPLES is the number of samples per timed repeat (over all threads), THREADS the number of threads and
// LIMIT_DEG the joint limits +-LIMIT_DEG in degrees (120 when left out). One JSON object goes to stdout;
// times are wall time in ns per sample (repeat time / SAMPLES), "checksum" is the mean of w in m^3.
//
// computeJointJacobians(model, data, q) does the forward kinematics (data.oMi) and fills data.J, whose
// columns are expressed in the WORLD frame. A change of frame multiplies J by a matrix of determinant 1, so
// data.J gives the same w as the LOCAL Jacobian of computeJointJacobian or getJointJacobian, and is faster.

#include <pinocchio/algorithm/jacobian.hpp>

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <Eigen/LU>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstddef>
#include <cstdio>
#include <exception>
#include <iomanip>
#include <iostream>
#include <limits>
#include <random>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

namespace
{

constexpr std::size_t kJoints = 6;
constexpr std::size_t kPool = 4096;  // joint vectors, cycled; a power of two
constexpr std::size_t kRepeats = 5;
constexpr double kL1 = 0.26;  // upper arm, m
constexpr double kL2 = 0.18;  // forearm, m
constexpr double kDeg = 3.14159265358979323846 / 180.0;  // rad per degree

using Matrix6 = Eigen::Matrix<double, 6, 6>;
using Vector6 = Eigen::Matrix<double, 6, 1>;
using Pool = std::vector<Vector6>;

/// One modified (Craig) DH row: T = Rx(alpha) Tx(a) Rz(theta) Tz(d); alpha in degrees, a and d in m.
struct DhRow
{
  double alpha_deg;
  double a;
  double d;
};

constexpr std::array<DhRow, kJoints> kRows = {{
  {0.0, 0.0, 0.0},
  {90.0, 0.0, 0.0},
  {-90.0, kL1, 0.0},
  {0.0, kL2, 0.0},
  {-90.0, 0.0, 0.0},
  {90.0, 0.0, 0.0},
}};

/// Command-line arguments; the limit is in degrees.
struct Arguments
{
  std::size_t samples;
  std::size_t threads;
  double limit_deg;
};

/// Result of the repeats of one route: median wall time in ns per sample and mean of w in m^3.
struct Timing
{
  double ns_per_sample;
  double mean_w;
};

/// Fixed part of a row, Rx(alpha) Tx(a) Tz(d) (Rz and Tz commute), in m.
pinocchio::SE3 placement(const DhRow & row)
{
  const Eigen::AngleAxisd turn(row.alpha_deg * kDeg, Eigen::Vector3d::UnitX());
  const Eigen::Matrix3d rotation = turn.toRotationMatrix();
  const Eigen::Vector3d translation = rotation * Eigen::Vector3d(row.a, 0.0, row.d);
  return pinocchio::SE3(rotation, translation);
}

/// The arm with joint limits +-limit rad; effort and speed limits are not used and are infinite.
pinocchio::Model build_arm(double limit)
{
  const Eigen::VectorXd unlimited = Eigen::VectorXd::Constant(1, std::numeric_limits<double>::infinity());
  const Eigen::VectorXd upper = Eigen::VectorXd::Constant(1, limit);
  const Eigen::VectorXd lower = -upper;
  pinocchio::Model model;
  pinocchio::JointIndex parent = 0;
  for (std::size_t i = 0; i < kJoints; ++i)
  {
    parent = model.addJoint(
      parent, pinocchio::JointModelRZ(), placement(kRows[i]), "joint" + std::to_string(i + 1), unlimited,
      unlimited, lower, upper);
  }
  return model;
}

/// Joint vectors in rad, uniform between the model's limits.
Pool random_pool(const pinocchio::Model & model)
{
  std::mt19937_64 engine(20240229);
  std::uniform_real_distribution<double> unit(0.0, 1.0);
  Pool pool(kPool);
  for (Vector6 & q : pool)
  {
    for (Eigen::Index j = 0; j < q.size(); ++j)
    {
      const double lower = model.lowerPositionLimit[j];
      q[j] = lower + unit(engine) * (model.upperPositionLimit[j] - lower);
    }
  }
  return pool;
}

/// |det J| in m^3 by LU; works in place, so data.J is overwritten (the next sample fills it anew).
struct LuRoute
{
  double operator()(pinocchio::Data & data) const
  {
    Eigen::Map<Matrix6> jacobian(data.J.data());
    const Eigen::PartialPivLU<Eigen::Ref<Matrix6>> lu(jacobian);
    return std::abs(lu.determinant());
  }
};

/// sqrt(det(J J^T)) in m^3 by LDLT.
struct LdltRoute
{
  double operator()(pinocchio::Data & data) const
  {
    const Eigen::Map<const Matrix6> jacobian(data.J.data());
    Matrix6 gram;
    gram.noalias() = jacobian * jacobian.transpose();
    const Eigen::LDLT<Matrix6> ldlt(gram);
    return std::sqrt(std::max(0.0, ldlt.vectorD().prod()));
  }
};

/// Sum of w in m^3 over `count` samples, taken from the pool in turn from index `first` on.
template<typename Route>
double sum_samples(
  const pinocchio::Model & model,
  pinocchio::Data & data,
  const Pool & pool,
  std::size_t first,
  std::size_t count)
{
  const Route route;
  double sum = 0.0;
  for (std::size_t i = first; i < first + count; ++i)
  {
    pinocchio::computeJointJacobians(model, data, pool[i % kPool]);
    sum += route(data);
  }
  return sum;
}

/// Sum of w in m^3 over all samples, split evenly over one thread per element of `workspaces`.
template<typename Route>
double run_threads(
  const pinocchio::Model & model,
  std::vector<pinocchio::Data> & workspaces,
  const Pool & pool,
  std::size_t samples)
{
  const std::size_t threads = workspaces.size();
  std::vector<double> sums(threads, 0.0);
  const auto work = [&](std::size_t t) {
    const std::size_t first = samples * t / threads;
    const std::size_t last = samples * (t + 1) / threads;
    sums[t] = sum_samples<Route>(model, workspaces[t], pool, first, last - first);
  };
  std::vector<std::thread> team;
  for (std::size_t t = 1; t < threads; ++t)
    team.emplace_back(work, t);
  work(0);
  for (std::thread & member : team)
    member.join();
  double total = 0.0;
  for (const double sum : sums)
    total += sum;
  return total;
}

/// Median of kRepeats repeats after a short untimed warm-up.
template<typename Route>
Timing time_route(const pinocchio::Model & model, const Pool & pool, const Arguments & arguments)
{
  std::vector<pinocchio::Data> workspaces(arguments.threads, pinocchio::Data(model));
  run_threads<Route>(model, workspaces, pool, std::min(arguments.samples, kPool * arguments.threads));
  const double samples = static_cast<double>(arguments.samples);
  std::array<double, kRepeats> ns{};
  double sum = 0.0;
  for (double & value : ns)
  {
    const auto start = std::chrono::steady_clock::now();
    sum = run_threads<Route>(model, workspaces, pool, arguments.samples);
    const std::chrono::duration<double, std::nano> elapsed = std::chrono::steady_clock::now() - start;
    value = elapsed.count() / samples;
  }
  std::sort(ns.begin(), ns.end());
  return {ns[kRepeats / 2], sum / samples};
}

/// A positive whole number from the command line.
std::size_t positive(const std::string & text)
{
  if (text.empty() || text.find_first_not_of("0123456789") != std::string::npos || std::stoull(text) == 0)
    throw std::invalid_argument("not a positive whole number: '" + text + "'");
  return std::stoull(text);
}

Arguments parse(const std::vector<std::string> & words)
{
  if (words.size() != 2 && words.size() != 3)
    throw std::invalid_argument("usage: pinocchio_loop SAMPLES THREADS [LIMIT_DEG]");
  const double limit_deg = words.size() == 3 ? std::stod(words[2]) : 120.0;
  if (!(limit_deg > 0.0))
    throw std::invalid_argument("LIMIT_DEG is not positive");
  return {positive(words[0]), positive(words[1]), limit_deg};
}

void print_json(const Arguments & arguments, const Timing & lu, const Timing & ldlt)
{
  std::cout << std::setprecision(10) << "{\"pinocchio\": \"" << PINOCCHIO_VERSION << "\", \"samples\": "
            << arguments.samples << ", \"threads\": " << arguments.threads
            << ", \"limit_deg\": " << arguments.limit_deg << ", \"ns_per_sample_lu\": " << lu.ns_per_sample
            << ", \"ns_per_sample_ldlt\": " << ldlt.ns_per_sample
            << ", \"ns_per_sample\": " << std::min(lu.ns_per_sample, ldlt.ns_per_sample)
            << ", \"checksum\": " << lu.mean_w << "}\n";
}

void run(const Arguments & arguments)
{
  const pinocchio::Model model = build_arm(arguments.limit_deg * kDeg);
  const Pool pool = random_pool(model);
  const Timing lu = time_route<LuRoute>(model, pool, arguments);
  const Timing ldlt = time_route<LdltRoute>(model, pool, arguments);
  if (std::abs(lu.mean_w - ldlt.mean_w) > 1e-6 * lu.mean_w)
    throw std::runtime_error("the LU and LDLT routes disagree");
  print_json(arguments, lu, ldlt);
}

}  // namespace

int main(int argc, char ** argv)
{
  try
  {
    run(parse(std::vector<std::string>(argv + 1, argv + argc)));
  }
  catch (const std::exception & error)
  {
    std::fprintf(stderr, "pinocchio_loop: %s\n", error.what());
    return 1;
  }
  return 0;
}
