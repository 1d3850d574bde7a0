/* The exported agent, compiled once. */
#define AUV_AGENT_IMPLEMENTATION
#include "auv_gym_controller/agent.h"
